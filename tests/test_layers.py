"""Imports point down only: each floor may import itself and what stands below."""

import ast
from pathlib import Path

import pytest

import ailsrs_jax

PACKAGE = Path(ailsrs_jax.__file__).parent
GROUND = {"errors", "files", "own_code", "versions"}
BELOW_TRAINERS = {"components", "envs", "data"}
ALLOWED = {
    "components": {"components"},
    "envs": {"envs"},
    "data": {"data"},
    "trainers": BELOW_TRAINERS | {"trainers"},
    "runs": BELOW_TRAINERS | {"trainers", "runs"},
    "sweeps": BELOW_TRAINERS | {"trainers", "runs", "sweeps"},
    "show": BELOW_TRAINERS | {"trainers", "runs", "sweeps", "show"},
}


def imported_floors(path: Path) -> set[str]:
    names = []
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom) and node.module:
            names += [f"{node.module}.{alias.name}" for alias in node.names]
        elif isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
    return {name.split(".")[1] for name in names if name.startswith("ailsrs_jax.")}


@pytest.mark.parametrize("floor", ALLOWED)
def test_floor_imports_only_what_is_below(floor: str) -> None:
    modules = list((PACKAGE / floor).rglob("*.py"))
    assert modules
    for module in modules:
        assert imported_floors(module) <= ALLOWED[floor] | GROUND, module


def test_trainers_do_not_import_one_another() -> None:
    shared = {"__init__", "algorithms", "presets"}
    trainers = {path.stem for path in (PACKAGE / "trainers").glob("*.py")} - shared
    assert trainers == {"ailsrs", "ars", "behavior_cloning", "gail", "trpo"}
    for name in trainers:
        text = (PACKAGE / "trainers" / f"{name}.py").read_text()
        for other in trainers - {name}:
            assert f"trainers.{other} " not in text
            assert f"trainers import {other}" not in text


def test_no_module_is_too_long() -> None:
    for module in PACKAGE.rglob("*.py"):
        assert len(module.read_text().splitlines()) <= 330, module
