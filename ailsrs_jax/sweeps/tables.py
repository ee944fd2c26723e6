"""What a sweep leaves: a row for each cell, learning curves, and wall-clock times apart."""

import csv
import dataclasses
import functools
import io
import json
import os
import platform
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeGuard

import jax
import numpy as np

from ailsrs_jax.envs.physics.mujoco_engine import available_cores
from ailsrs_jax.envs.registry import TASKS
from ailsrs_jax.errors import UserError
from ailsrs_jax.files import read_json_object, write_atomically
from ailsrs_jax.runs.demonstrate import EPISODE_LENGTH, expert_demonstrations
from ailsrs_jax.runs.evaluation import evaluate, evaluate_random
from ailsrs_jax.runs.loop import Result
from ailsrs_jax.runs.storage.metrics import read_metrics, read_rows
from ailsrs_jax.runs.training_data import NUM_TRAJECTORIES
from ailsrs_jax.sweeps.cells import Cell
from ailsrs_jax.sweeps.results import DONE, NOT_RUN, CellResult

RESULT_COLUMNS = tuple(field.name for field in dataclasses.fields(CellResult))
CURVE_COLUMNS = (
    *("cell", "iteration", "env_steps", "evaluation_return", "evaluation_length"),
    *("expert_distance", "imitation_reward", "policy_score", "expert_score"),
)
TIMING_COLUMNS = (
    *("cell", "train_seconds", "compile_seconds", "seconds_to_90_percent", "hardware"),
)
RESULT_FILE = "row.json"  # in a cell's directory, when it is finished or has failed

TableRow = Mapping[str, Any]


def finished_row(cell: Cell, result: Result, directory: Path, episodes: int) -> TableRow:
    """What ``results.csv`` says of a cell that is trained; its policy is evaluated here.

    Gymnasium's tasks have their own time limit. Where training had another, what it measured is of
    other episodes than the expert's, and is left out.
    """
    config = result.config
    metrics = read_metrics(directory / "metrics.csv")
    returns, steps = metrics["evaluation_return"], metrics["env_steps"]
    policy = result.policies[cell.seed]
    length = config.settings.episode_length
    if config.env_id in TASKS:
        physics, limit = "gymnasium", EPISODE_LENGTH
    else:
        physics, limit = cell.decided_physics, length
    evaluation = evaluate(policy, episodes, physics, episode_length=limit)
    if not np.isfinite(evaluation.returns).all():
        raise UserError("the kept policy's returns are not all finite")
    expert = None if result.expert_returns is None else float(np.mean(result.expert_returns))
    if expert is None:
        expert = shipped_expert_return(config.env_id, config.physics)
    random = random_return(config.env_id, physics, limit)
    reached = np.flatnonzero(returns >= (np.inf if expert is None else ninety_percent(expert)))
    measured = np.isfinite(returns)  # else the evaluation diverged
    # Of an iteration's policy, for as many steps as the iteration takes.
    weights = np.diff(steps, prepend=0)[measured]
    same_limit = length == limit
    normalized = None
    if expert is not None and expert != random:
        normalized = (evaluation.mean - random) / (expert - random)
    return cell_columns(cell) | {
        "iterations": len(steps),
        "env_steps": int(steps[-1]),
        "kept_iteration": result.kept_iterations[cell.seed],
        "return_mean": evaluation.mean,
        "return_std": evaluation.std,
        "length_mean": float(evaluation.lengths.mean()),
        "last_return": float(returns[-1]) if same_limit else None,
        "mean_return_over_training": (
            float(returns[measured] @ weights / weights.sum())
            if same_limit and weights.any()
            else None
        ),
        "steps_to_90": int(steps[reached[0]]) if same_limit and len(reached) else None,
        "expert_return": expert,
        "random_return": random,
        "normalized": normalized,
        "status": DONE,
    }


def failed_row(cell: Cell, reason: str) -> TableRow:
    """What ``results.csv`` says of a cell that could not be trained."""
    return cell_columns(cell) | {"status": f"failed: {' '.join(reason.split())}"}


def cell_columns(cell: Cell) -> dict[str, Any]:
    """What is known of a cell before it runs."""
    return {
        "cell": cell.name,
        "label": cell.label,
        "algorithm": cell.algorithm,
        "env_id": cell.env_id,
        "preset": cell.preset,
        "settings": ";".join(f"{name}={value}" for name, value in cell.settings.items()),
        "demonstrations": cell.demonstrations,
        "num_trajectories": cell.num_trajectories,
        "subsample": cell.subsample,
        "seed": cell.seed,
        "physics": cell.engine,
    }


def timing_row(cell: Cell, row: TableRow, directory: Path) -> TableRow | None:
    """What ``timings.csv`` says of a trained cell; None if not every iteration was timed."""
    try:
        times = read_metrics(directory / "seconds.csv")
        seconds, compiling = times["seconds"], times["compile_seconds"]
    except (UserError, KeyError):
        return None
    if len(seconds) != row["iterations"]:
        return None
    to_90 = None
    if row["steps_to_90"] is not None:
        steps = read_metrics(directory / "metrics.csv")["env_steps"]
        reached = int(np.searchsorted(steps, row["steps_to_90"]))
        to_90 = float(seconds[: reached + 1].sum())
    return {
        "cell": cell.name,
        "train_seconds": float(seconds.sum()),
        "compile_seconds": float(compiling.sum()),
        "seconds_to_90_percent": to_90,
        "hardware": hardware(),
    }


def save_result(directory: Path, row: TableRow, timing: TableRow | None) -> None:
    """Mark a cell as finished, or failed."""
    text = json.dumps({"row": row, "timing": timing}, indent=1)
    write_atomically(directory / RESULT_FILE, lambda file: file.write(f"{text}\n".encode()))


def load_result(directory: Path) -> tuple[TableRow, TableRow | None] | None:
    """The row of a cell and its times; None if it has not been finished.

    Raises:
        UserError: the file is damaged.
    """
    path = directory / RESULT_FILE
    if not os.path.lexists(path):
        return None
    content = read_json_object(path, "the result of a cell; delete it to evaluate the cell again")
    row, timing = content.get("row"), content.get("timing")
    if (
        not (_is_flat(row) and isinstance(row.get("status"), str))
        or not (timing is None or _is_flat(timing))
        or row.get("cell") != directory.name  # it becomes a path
    ):
        raise UserError(f"{path} is not of this cell; delete it to evaluate the cell again")
    return row, timing


def _is_flat(row: Any) -> TypeGuard[TableRow]:
    return isinstance(row, dict) and not any(isinstance(x, dict | list) for x in row.values())


def write_tables(output: Path, cells: Sequence[Cell]) -> list[TableRow]:
    """Write the tables of what there is so far, in the order of ``cells``; the rows of results.

    Several processes may share the directory: whoever is the last to write has seen what the others
    have finished, because each looks again after it has written.
    """
    written = None
    while True:
        found = [(cell, load_result(output / "cells" / cell.name)) for cell in cells]
        # What is known of a cell is added, lest an earlier version's result lacks some of it.
        results: list[tuple[TableRow, TableRow | None]] = [
            ({**cell_columns(cell), **row}, timing)
            for cell, result in found
            for row, timing in [result or ({"status": NOT_RUN}, None)]
        ]
        seen = json.dumps(results)  # NaN is not equal to itself
        if seen == written:
            return [row for row, _ in results]
        rows = [row for row, _ in results]
        _write_csv(output / "results.csv", RESULT_COLUMNS, rows)
        _write_csv(output / "curves.csv", CURVE_COLUMNS, _curves(output, rows))
        timings = [timing for _, timing in results if timing is not None]
        _write_csv(output / "timings.csv", TIMING_COLUMNS, timings)
        written = seen


def _curves(output: Path, rows: Sequence[TableRow]) -> Iterable[TableRow]:
    for row in rows:
        if row["status"] == DONE:
            path = output / "cells" / row["cell"] / "metrics.csv"
            header, *lines = read_rows(path)
            for number, line in enumerate(lines, start=2):
                if len(line) != len(header):
                    raise UserError(
                        f"{path}: line {number} has {len(line)} of {len(header)} values"
                    )
                yield {"cell": row["cell"]} | dict(zip(header, line, strict=True))


def _write_csv(path: Path, columns: Sequence[str], rows: Iterable[TableRow]) -> None:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    for row in rows:
        values = (row.get(column) for column in columns)
        writer.writerow(["" if value is None else value for value in values])
    write_atomically(path, lambda file: file.write(text.getvalue().encode()))


def ninety_percent(expert_return: float) -> float:
    """The return that counts as nine tenths of the expert's, which may be negative."""
    return expert_return - 0.1 * abs(expert_return)


@functools.cache
def random_return(env_id: str, physics: str, episode_length: int) -> float:
    """Mean return of 100 episodes of uniformly random actions."""
    return evaluate_random(env_id, physics=physics, episode_length=episode_length).mean


@functools.cache
def shipped_expert_return(env_id: str, engine: str) -> float | None:
    """Mean return of the shipped expert's demonstrations, if one ships."""
    try:
        return float(expert_demonstrations(env_id, NUM_TRAJECTORIES, engine).returns.mean())
    except UserError:
        return None


def hardware() -> str:
    """What computes here, without the name of the machine."""
    device = jax.devices()[0]
    if device.platform != "cpu":
        return f"{jax.device_count()} x {device.device_kind}"
    cores = available_cores()
    return f"{cores} core{'s' * (cores > 1)}, {_processor()}"


def _processor() -> str:
    """Its name, with what tells apart those that virtual machines give the same name."""
    try:
        text = Path("/proc/cpuinfo").read_text()
        fields = dict(re.findall(r"(?m)^([a-z ]+?)\s*: (.+)$", text))
        return f"{fields['model name']} (family {fields['cpu family']}, model {fields['model']})"
    except (OSError, KeyError):  # not Linux, or no x86
        return platform.processor() or platform.machine()
