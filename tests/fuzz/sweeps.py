"""Damaged files of a sweep: its spec, its grid, its results."""

import dataclasses
import json
import re
from pathlib import Path
from typing import Any

from hypothesis import strategies as st

from tests.fuzz.damage import damaged_bytes, odd_values, write_damaged


def make_results(draw: st.DrawFn, path: Path) -> None:
    """The three tables of a sweep."""
    from ailsrs_jax.sweeps.results import CellResult

    words = {"cell": "a", "status": "done", "env_id": "Hopper-v5", "settings": "noise_std=1"}
    words |= {"states_only": "False"}
    names = [field.name for field in dataclasses.fields(CellResult)]
    curve = ["cell", "iteration", "env_steps", "evaluation_return"]
    timing = ["cell", "train_seconds", "compile_seconds", "seconds_to_90_percent", "hardware"]
    tables: dict[str, list[list[Any]]] = {
        "results.csv": [names, *([words.get(x, i) for x in names] for i in range(2))],
        "curves.csv": [curve, *(["a", i, 10 * i, 0.5] for i in range(3))],
        "timings.csv": [timing, ["a", 1, 2, "", "CPU"]],
    }
    tables["results.csv"][2][0] = "b"
    write_damaged(draw, path, tables)


def read_sweep_results(path: Path) -> object:
    from ailsrs_jax.sweeps.results import read_results

    return [cell.normalized_over_training for cell in read_results(path).cells]


SPEC = """episodes = 3
grid = [
  {env = ["hopper"], algorithm = "ars", seeds = [0, 1], settings = {noise_std = 1}},
  {env = "swimmer", algorithm = "trpo", label = "b", settings = {discount = [1]}},
]
"""
TOKENS = re.findall(r'\w+|"\w*"|.|\n', SPEC)
ODD_TOKENS = ["", "[[", "inf", "nan", "1e999", f"0x{'f' * 2000}", "[" * 10**5, "{a=" * 10**5]
ODD_TOKENS += ["9" * 10**5, " " * 2**21, "\0", "[]", "{}", "1979-05-27", "env", "seeds"]


def odd_token(value: Any) -> str:
    try:
        return json.dumps(value)
    except (RecursionError, ValueError):
        return "[" * 1000


def make_spec(draw: st.DrawFn, path: Path) -> None:
    tokens = list(TOKENS)
    for at in draw(st.lists(st.integers(0, len(tokens) - 1), max_size=3)):
        odd = st.sampled_from(ODD_TOKENS) | st.sampled_from(TOKENS) | odd_values.map(odd_token)
        tokens[at] = draw(odd)
    content = "".join(tokens).encode(errors="replace")
    path.write_bytes(draw(st.just(content) | damaged_bytes(content)))


def read_sweep_spec(path: Path) -> object:
    from ailsrs_jax.sweeps.spec import expand, read_spec

    return expand(read_spec(path))


def make_sweep(draw: st.DrawFn, path: Path) -> None:
    """The directory of a shard: its grid, the result of its cell, and the cell's metrics."""
    from ailsrs_jax.runs.spec import RunSpec
    from ailsrs_jax.sweeps.cells import Cell, Sweep

    spec = RunSpec("Hopper-v5", algorithm="ars")
    cell = Cell("a-seed0", "A", spec, {"noise_std": 1.0}, "mujoco", "abc", None)
    row = {"cell": "a-seed0", "status": "done", "return_mean": 1.0}
    timing = {"cell": "a-seed0", "train_seconds": 1.0}
    files: dict[str, Any] = {
        "sweep.json": dataclasses.asdict(Sweep((cell,), 3)),
        "cells/a-seed0/row.json": {"row": row, "timing": timing},
        "cells/a-seed0/metrics.csv": [["iteration", "seed", "env_steps"], [0, 0, 10], [1, 0, 20]],
    }
    write_damaged(draw, path, files)


def read_sweep(path: Path) -> object:
    from ailsrs_jax.sweeps.merge import merge_sweeps

    return merge_sweeps(path / "merged", [path])
