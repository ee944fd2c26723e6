"""The rows of a sweep's tables: what was measured of each cell, and the tables made of all rows."""

import functools
import json
import platform
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeGuard

import jax
import numpy as np

from ailsrs_jax.envs.registry import TASKS
from ailsrs_jax.errors import InUseError, UserError, one_line
from ailsrs_jax.files import read_json_if_there, write_atomically, write_json
from ailsrs_jax.runs.demonstrate import expert_demonstrations
from ailsrs_jax.runs.evaluation import evaluate, evaluate_random
from ailsrs_jax.runs.storage.journal import Result
from ailsrs_jax.runs.storage.metrics import as_csv, read_metrics, share_of
from ailsrs_jax.runs.training_data import NUM_TRAJECTORIES
from ailsrs_jax.sweeps.cells import Cell
from ailsrs_jax.sweeps.results import COLUMNS, DONE, NOT_RUN, Curve, read_table
from ailsrs_jax.trainers.parts.settings import as_text
from ailsrs_jax.versions import available_cores

ROW_FILE = "row.json"  # in the directory of a cell that has finished or failed

TableRow = Mapping[str, Any]  # values by column; None and missing ones become empty fields


def finish(cell: Cell, outcome: Result | Exception, directory: Path, episodes: int) -> TableRow:
    """Evaluate the policy that a cell has kept, or record why the cell has failed."""
    timing = None
    try:
        if isinstance(outcome, Exception):
            raise outcome
        row = finished_row(cell, outcome, directory, episodes)
        timing = timing_row(cell, row, directory)
    except Exception as error:
        row = failed_row(cell, str(error) if isinstance(error, UserError) else one_line(error))
    if not isinstance(outcome, InUseError):  # the process that uses the directory will save a row
        save_row(directory, row, timing)
    return row


def finished_row(cell: Cell, result: Result, directory: Path, episodes: int) -> TableRow:
    """Evaluate the policy that a cell has kept, and make its row of ``results.csv``.

    All episodes have the run's horizon. Columns that compare with the expert are empty if its
    demonstrations have another time limit.

    Raises:
        UserError: the policy's returns are not finite, or the metrics cannot be read.
    """
    config = result.config
    length = config.settings.episode_length
    physics = "gymnasium" if config.env_id in TASKS else cell.spec.physics
    evaluation = evaluate(result.policies[cell.seed], episodes, physics, episode_length=length)
    if not np.isfinite(evaluation.returns).all():
        raise UserError("the kept policy's returns are not all finite")
    if result.expert_returns is None:
        expert = shipped_expert_return(config.env_id, config.physics, length)
        comparable = True
    else:
        expert = float(np.mean(result.expert_returns))
        comparable = result.demonstrated_length == length
    random = random_return(config.env_id, physics, length)
    row = cell_columns(cell) | {
        "kept_iteration": result.kept_iterations[cell.seed],
        "return_mean": evaluation.mean,
        "return_std": evaluation.std,
        "length_mean": float(evaluation.lengths.mean()),
        "expert_return": expert,
        "random_return": random,
        "normalized": None,
        "status": DONE,
    }
    if comparable and expert is not None and expert != random:
        row["normalized"] = (evaluation.mean - random) / (expert - random)
    metrics = read_metrics(directory / "metrics.csv")
    return row | _over_training(metrics, expert, comparable=comparable)


def _over_training(
    metrics: Mapping[str, np.ndarray], expert: float | None, *, comparable: bool
) -> dict[str, Any]:
    """Summarize the learning curve; returns only if they are ``comparable`` with the expert's."""
    returns, steps = metrics["evaluation_return"], metrics["env_steps"]
    row = dict.fromkeys(("last_return", "mean_return_over_training", "steps_to_90"))
    row |= {"iterations": len(steps), "env_steps": int(steps[-1])}
    if comparable:
        row["last_return"] = float(returns[-1])
        measured = np.isfinite(returns)  # the other evaluations diverged
        # The return of an iteration counts for as many steps as the iteration takes.
        weights = np.diff(steps, prepend=0)[measured]
        if weights.any():
            row["mean_return_over_training"] = float(returns[measured] @ weights / weights.sum())
        if expert is not None:
            reached = Curve(metrics["iteration"], steps, returns).steps_to(share_of(expert, 0.9))
            row["steps_to_90"] = int(reached) if np.isfinite(reached) else None
    return row


def failed_row(cell: Cell, reason: str) -> TableRow:
    """Make the row of ``results.csv`` for a cell that has failed."""
    return cell_columns(cell) | {"status": f"failed: {' '.join(reason.split())}"}


def cell_columns(cell: Cell) -> dict[str, Any]:
    """Return the columns of ``results.csv`` that are known before a cell runs."""
    spec = cell.spec
    settings = (f"{name}={as_text(value)}" for name, value in spec.settings.items())
    same = ("algorithm", "preset", "demonstrations", "num_trajectories", "draw_from")
    return {name: getattr(spec, name) for name in (*same, "subsample", "states_only")} | {
        "cell": cell.name,
        "label": cell.label,
        "env_id": spec.env,
        "settings": ";".join(settings),
        "seed": cell.seed,
        "physics": cell.engine,
    }


def timing_row(cell: Cell, row: TableRow, directory: Path) -> TableRow:
    """Make the row of ``timings.csv`` for a finished cell.

    Raises:
        UserError: the times cannot be read.
    """
    times = read_metrics(directory / "seconds.csv")
    to_90 = None
    if row["steps_to_90"] is not None:
        steps = read_metrics(directory / "metrics.csv")["env_steps"]
        reached = np.searchsorted(steps, row["steps_to_90"])
        to_90 = float(times["seconds"][: reached + 1].sum())
    return {
        "cell": cell.name,
        "train_seconds": float(times["seconds"].sum()),
        "compile_seconds": float(times["compile_seconds"].sum()),
        "seconds_to_90_percent": to_90,
        "hardware": hardware(),
    }


def save_row(directory: Path, row: TableRow, timing: TableRow | None) -> None:
    """Record that a cell has finished or failed."""
    write_json(directory / ROW_FILE, {"row": row, "timing": timing})


def load_row(directory: Path) -> tuple[TableRow, TableRow | None]:
    """Read the rows of results and timings of a cell; {} and None before it finishes or fails.

    Raises:
        UserError: the file is damaged.
    """
    path = directory / ROW_FILE
    what = "the row of a cell; delete it to evaluate the cell again"
    content = read_json_if_there(path, what)
    if content is None:
        return {}, None
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
    """Write the tables of all cells so far, in the order of ``cells``; return the result rows.

    Several processes may share the directory. Each looks again after it has written, so the last
    one to write has seen the rows of all others.
    """
    written = None
    while True:
        found = [load_row(output / "cells" / cell.name) for cell in cells]
        rows: list[TableRow] = [
            cell_columns(cell) | {"status": NOT_RUN} | dict(row)
            for cell, (row, _) in zip(cells, found, strict=True)
        ]
        timings = [timing for _, timing in found if timing is not None]
        seen = json.dumps([rows, timings])  # as text, because NaN is not equal to itself
        if seen == written:
            return rows
        _write_csv(output / "results.csv", rows)
        _write_csv(output / "curves.csv", _curves(output, rows))
        _write_csv(output / "timings.csv", timings)
        written = seen


def _curves(output: Path, rows: Sequence[TableRow]) -> Iterable[TableRow]:
    for row in rows:
        if row["status"] == DONE:
            for _, fields in read_table(output / "cells" / row["cell"] / "metrics.csv", ()):
                yield {"cell": row["cell"]} | fields


def _write_csv(path: Path, rows: Iterable[TableRow]) -> None:
    columns = COLUMNS[path.name]
    fields = ([row.get(name) for name in columns] for row in rows)
    write_atomically(path, as_csv([columns, *fields]))


@functools.cache
def random_return(env_id: str, physics: str, episode_length: int) -> float:
    """Compute the mean return of uniformly random actions."""
    return evaluate_random(env_id, physics, episode_length).mean


@functools.cache
def shipped_expert_return(env_id: str, engine: str, episode_length: int) -> float | None:
    """Compute the mean return of the shipped expert's demonstrations; None without an expert."""
    try:
        recorded = expert_demonstrations(
            env_id, NUM_TRAJECTORIES, engine, episode_length=episode_length
        )
        return float(recorded.returns.mean())
    except UserError:
        return None


def hardware() -> str:
    """Describe the devices or the processor, without the name of the machine."""
    device = jax.devices()[0]
    if device.platform != "cpu":
        return f"{jax.device_count()} x {device.device_kind}"
    cores = available_cores()
    return f"{cores} core{'s' * (cores > 1)}, {_processor()}"


def _processor() -> str:
    """Name the processor, with its model number because virtual machines hide the full name."""
    try:
        text = Path("/proc/cpuinfo").read_text()
        fields = dict(re.findall(r"(?m)^([a-z ]+?)\s*: (.+)$", text))
        return f"{fields['model name']} (family {fields['cpu family']}, model {fields['model']})"
    except (OSError, KeyError):  # not Linux, or not x86
        return platform.processor() or platform.machine()
