"""Damaged files of a sweep: its spec, its grid, its results."""

import dataclasses
import json
from pathlib import Path
from typing import Any

from tests.fuzz.mutations import Rng, make_csv, mutate_bytes, mutate_tree, mutated_json


def make_results(path: Path, rng: Rng) -> None:
    """What a sweep has measured, one of its three tables damaged."""
    from ailsrs_jax.sweeps.results import CellResult

    words = {"cell": "a", "status": "done", "env_id": "Hopper-v5", "settings": "noise_std=1"}
    names = [field.name for field in dataclasses.fields(CellResult)]
    curve, timing = (
        "cell iteration env_steps evaluation_return",
        "cell train_seconds compile_seconds seconds_to_90_percent hardware",
    )
    tables: dict[str, list[list[Any]]] = {
        "results.csv": [names, *([words.get(x, i) for x in names] for i in range(2))],
        "curves.csv": [curve.split(), *(["a", i, 10 * i, 0.5] for i in range(3))],
        "timings.csv": [timing.split(), ["a", 1, 2, "", "CPU"]],
    }
    tables["results.csv"][2][0] = "b"
    path.mkdir()
    damaged = rng.choice(sorted(tables))
    for name, rows in tables.items():
        if name == damaged:
            make_csv(rows, path / name, rng)
        else:
            (path / name).write_text("".join(",".join(map(str, row)) + "\n" for row in rows))


def read_sweep_results(path: Path) -> object:
    from ailsrs_jax.sweeps.results import read_results

    return [cell.normalized_over_training for cell in read_results(path).cells]


def sweep_spec() -> dict[str, Any]:
    return {
        "episodes": 3,
        "grid": [
            {"env": ["hopper"], "algorithm": "ars", "seeds": [0, 1], "settings": {"noise_std": 1}},
            {"env": "swimmer", "algorithm": "trpo", "label": "b", "settings": {"discount": [1]}},
        ],
    }


def make_spec(path: Path, rng: Rng) -> None:
    """TOML has tables, lists, texts and numbers, as JSON has; only the brackets differ."""
    tree: Any = sweep_spec()
    for _ in range(rng.choice([0, 1, 1, 2])):
        tree = mutate_tree(tree, rng)
    text = toml(tree) if isinstance(tree, dict) else str(tree)
    if rng.random() < 0.03:
        text = "a = " + rng.choice(["[" * 10**5, "{a=" * 10**5, "9" * 10**5, " " * 2**21])
    content = text.encode(errors="replace")
    path.write_bytes(mutate_bytes(content, rng) if rng.random() < 0.3 else content)


def toml(table: dict[str, Any]) -> str:
    """Inline tables only."""
    return "".join(f"{json.dumps(key)} = {toml_value(value)}\n" for key, value in table.items())


def toml_value(value: Any) -> str:
    try:
        if isinstance(value, dict):
            pairs = (f"{json.dumps(key)} = {toml_value(each)}" for key, each in value.items())
            return f"{{{', '.join(pairs)}}}"
        if isinstance(value, list):
            return f"[{', '.join(map(toml_value, value))}]"
        if isinstance(value, int) and value >= 2**64:
            return hex(value << 2000)  # read by Python, but with too many digits to be printed
        return "''" if value is None else json.dumps(value).replace("Infinity", "inf").lower()
    except (RecursionError, ValueError):
        return "[" * 1000


def read_sweep_spec(path: Path) -> object:
    from ailsrs_jax.sweeps.spec import expand, read_spec

    return expand(read_spec(path))


def make_sweep(path: Path, rng: Rng) -> None:
    """The directory of a shard: its grid, or the result of its cell, damaged."""
    from ailsrs_jax.sweeps.cells import Cell

    texts = {"name": "a-seed0", "label": "A", "algorithm": "ars", "env_id": "Hopper-v5"}
    cell = {field.name: texts.get(field.name, 1) for field in dataclasses.fields(Cell)}
    files: dict[str, Any] = {
        "sweep.json": {"cells": [cell | {"settings": {}, "all_settings": {}}], "episodes": 3},
        "cells/a-seed0/result.json": {
            "row": {"cell": "a-seed0", "status": "done", "return_mean": 1.0},
            "timing": {"cell": "a-seed0", "train_seconds": 1.0},
        },
    }
    (path / "cells" / "a-seed0").mkdir(parents=True)
    damaged = rng.choice(sorted(files))
    for name, tree in files.items():
        content = mutated_json(tree, rng) if name == damaged else json.dumps(tree).encode()
        (path / name).write_bytes(content)
    rows: list[list[Any]] = [["iteration", "seed", "env_steps"], [0, 0, 10], [1, 0, 20]]
    metrics = path / "cells" / "a-seed0" / "metrics.csv"
    if rng.random() < 0.3:
        make_csv(rows, metrics, rng)
    else:
        metrics.write_text("".join(",".join(map(str, row)) + "\n" for row in rows))


def read_sweep(path: Path) -> object:
    from ailsrs_jax.sweeps.merge import merge_sweeps

    return merge_sweeps(path / "merged", [path])
