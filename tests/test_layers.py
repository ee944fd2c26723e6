"""Imports between the folders of the package point down, and no two folders import each other."""

import ast
from pathlib import Path

import pytest

import ailsrs_jax

PACKAGE = Path(ailsrs_jax.__file__).parent
GROUND = {"errors", "files", "host_calls", "own_code", "versions"}
# Each folder may import itself, the folders before it in this list that stand in its line, and the
# modules on the ground. Folders beside one another do not import one another.
BELOW: dict[str, set[str]] = {
    "workers": set(),
    "components": set(),
    "envs/physics": set(),
    "envs/tasks": {"envs/physics"},
    "envs": {"envs/physics", "envs/tasks", "workers"},
    "data/formats": set(),
    "data": {"data/formats"},
}
TRAINING = {"workers", "components", "envs", "envs/physics", "envs/tasks", "data", "data/formats"}
for folder in (
    *("trainers/parts", "trainers", "runs/storage", "runs"),
    *("runs/experts", "runs/benchmark", "runs/inspection"),
    *("sweeps", "show/episodes", "show", "show/reports", "cli"),
):
    BELOW[folder] = set(TRAINING)
    TRAINING.add(folder)
BELOW["runs/benchmark"].remove("runs/experts")
BELOW["runs/inspection"] -= {"runs/experts", "runs/benchmark"}
MOST_LINES = 300
MOST_FILES = 13  # in a folder, without __init__


def modules(folder: str) -> list[Path]:
    return sorted(path for path in (PACKAGE / folder).glob("*.py") if path.name != "__init__.py")


def imported(path: Path) -> set[str]:
    """The modules of ours that a module imports, as ``folder/module``, or ``folder`` itself."""
    names = []
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom) and node.module:
            names += [f"{node.module}.{alias.name}" for alias in node.names]
        elif isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
    paths = [name.removeprefix("ailsrs_jax.") for name in names if name.startswith("ailsrs_jax.")]
    found = set()
    for parts in (path.split(".") for path in paths):
        while parts and not PACKAGE.joinpath(*parts).with_suffix(".py").is_file():
            if PACKAGE.joinpath(*parts).is_dir():
                break
            parts = parts[:-1]
        found.add("/".join(parts))
    return found


@pytest.mark.parametrize("folder", BELOW)
def test_a_folder_imports_only_what_is_below(folder: str) -> None:
    assert modules(folder)
    for module in modules(folder):
        for name in imported(module) - GROUND:
            home = name if (PACKAGE / name).is_dir() else name.rpartition("/")[0]
            # What envs/__init__ exports is Brax's, and is below all environments.
            if name != "envs":
                assert home in BELOW[folder] | {folder}, f"{module} imports {name}"


def test_the_ground_imports_only_itself() -> None:
    for name in GROUND:
        assert imported(PACKAGE / f"{name}.py") <= GROUND, name


def test_no_folder_is_left_out() -> None:
    folders = {str(path.parent.relative_to(PACKAGE)) for path in PACKAGE.rglob("*.py")}
    assert folders == {*BELOW, "."}


def test_trainers_do_not_import_one_another() -> None:
    trainers = {"ailsrs", "ars", "behavior_cloning", "gail", "trpo"}
    assert {path.stem for path in modules("trainers")} == trainers | {"algorithms", "presets"}
    for name in trainers:
        others = {f"trainers/{other}" for other in trainers - {name}}
        assert not imported(PACKAGE / "trainers" / f"{name}.py") & others


def test_no_module_is_too_long_and_no_folder_too_full() -> None:
    for folder in BELOW:
        assert len(modules(folder)) <= MOST_FILES, folder
        for module in modules(folder):
            assert len(module.read_text().splitlines()) <= MOST_LINES, module


def test_an_iteration_fits_on_a_screen() -> None:
    tree = ast.parse((PACKAGE / "trainers" / "ailsrs.py").read_text())
    (update,) = (
        node
        for node in ast.walk(tree)
        if isinstance(node, ast.FunctionDef) and node.name == "update"
    )
    assert update.end_lineno is not None
    assert update.end_lineno - update.lineno < 48
