"""What a sweep has measured: its ``results.csv``, ``curves.csv`` and ``timings.csv``, read."""

import dataclasses
import math
from pathlib import Path
from typing import Any

import numpy as np

from ailsrs_jax.errors import UserError
from ailsrs_jax.runs.storage.metrics import read_rows

DONE = "done"
NOT_RUN = "not run"


@dataclasses.dataclass(frozen=True)
class CellResult:
    """One row of ``results.csv``: an algorithm on a task, with one seed. NaN is an empty field."""

    cell: str  # its name
    label: str  # of its entry in the sweep
    algorithm: str
    env_id: str
    preset: str
    settings: str  # NAME=VALUE;NAME=VALUE of what differs from the preset
    demonstrations: str  # what they are, if not the shipped expert's
    num_trajectories: int | None  # None where it learns from the environment's reward
    subsample: int  # one step in so many of them
    seed: int
    physics: str
    iterations: float
    env_steps: float  # live ones, in training
    kept_iteration: float
    return_mean: float  # of the kept policy, in Gymnasium's own environment, as the next two
    return_std: float  # over episodes
    length_mean: float
    last_return: float  # of the last iteration's policy
    mean_return_over_training: float
    steps_to_90: float  # live steps until 0.9 of the expert's return; NaN if never
    expert_return: float  # NaN where there is no expert, as on one's own task
    random_return: float
    normalized: float  # return_mean as a score: 0 is random, 1 the expert
    status: str  # DONE, NOT_RUN or "failed: why"

    @property
    def done(self) -> bool:
        """Whether it ended with a policy."""
        return self.status == DONE

    @property
    def normalized_over_training(self) -> float:
        """``mean_return_over_training`` as a score: 0 is random, 1 the expert."""
        return self.normalize(self.mean_return_over_training)

    def normalize(self, returns: Any) -> Any:
        """Returns as scores, of the same shape: (returns − random) / (expert − random)."""
        scale = self.expert_return - self.random_return
        return (returns - self.random_return) / (scale or math.nan)


@dataclasses.dataclass(frozen=True)
class Curve:
    """The learning curve of a cell; a row of each array is an iteration. NaN is an empty field."""

    iterations: np.ndarray
    env_steps: np.ndarray
    returns: np.ndarray  # of the evaluation episodes


@dataclasses.dataclass(frozen=True)
class Timing:
    """Wall-clock facts of a cell [s]. NaN is an empty field."""

    train_seconds: float
    compile_seconds: float
    seconds_to_90_percent: float  # NaN if never
    hardware: str


@dataclasses.dataclass(frozen=True)
class SweepResults:
    """Everything a sweep has measured; of cells that failed there may be no curve or timing."""

    cells: tuple[CellResult, ...]  # in the sweep's order
    curves: dict[str, Curve]  # by the cell's name
    timings: dict[str, Timing]  # by the cell's name

    @property
    def done(self) -> list[CellResult]:
        """The cells that ended with a policy."""
        return [cell for cell in self.cells if cell.done]


# What a cell that is done has in any case.
_MEASURED = (
    *("iterations", "env_steps", "kept_iteration", "return_mean", "return_std", "length_mean"),
    "random_return",
)
_TEXT = (
    *("cell", "label", "algorithm", "env_id", "preset", "settings", "demonstrations", "physics"),
    "status",
)


def read_results(directory: Path) -> SweepResults:
    """Read the three files of a sweep's directory, or of committed results.

    Raises:
        UserError: one cannot be read, lacks a column or a value, or holds what is not a number.
    """
    cells: dict[str, CellResult] = {}
    path = directory / "results.csv"
    for where, row in _read_table(path, [field.name for field in dataclasses.fields(CellResult)]):
        cell = _cell(where, row)
        if cell.cell in cells:
            raise UserError(f"{where}: cell {cell.cell} is there twice")
        cells[cell.cell] = cell
    return SweepResults(
        cells=tuple(cells.values()),
        curves=_read_curves(directory / "curves.csv"),
        timings=_read_timings(directory / "timings.csv"),
    )


def _cell(where: str, row: dict[str, str]) -> CellResult:
    values: dict[str, Any] = {name: row[name] for name in _TEXT}
    for name in row.keys() - values.keys():
        values[name] = _number(where, name, row[name])
    for name in ("seed", "num_trajectories", "subsample"):
        if math.isnan(values[name]):
            values[name] = None
        elif values[name] % 1:
            raise UserError(f"{where}: {name} is '{row[name]}', not a whole number")
        else:
            values[name] = int(values[name])
    for name in ("seed", "subsample"):
        if values[name] is None:
            raise UserError(f"{where}: there is no {name}")
    cell = CellResult(**values)
    if cell.done:
        for name in _MEASURED:
            if not math.isfinite(values[name]):
                raise UserError(f"{where}: {name} of a cell that is done is '{row[name]}'")
    return cell


def _read_curves(path: Path) -> dict[str, Curve]:
    columns = ("iteration", "env_steps", "evaluation_return")
    rows: dict[str, list[list[float]]] = {}
    for where, row in _read_table(path, ["cell", *columns]):
        values = [_number(where, name, row[name]) for name in columns]
        rows.setdefault(row["cell"], []).append(values)
    return {name: Curve(*np.array(values).T) for name, values in rows.items()}


def _read_timings(path: Path) -> dict[str, Timing]:
    columns = ("train_seconds", "compile_seconds", "seconds_to_90_percent")
    timings = {}
    for where, row in _read_table(path, ["cell", *columns, "hardware"]):
        values: dict[str, Any] = {name: _number(where, name, row[name]) for name in columns}
        timings[row["cell"]] = Timing(hardware=row["hardware"], **values)
    return timings


def _read_table(path: Path, columns: list[str]) -> list[tuple[str, dict[str, str]]]:
    """Of each row, where it is, and its fields in ``columns`` by name; others are left out."""
    header, *rows = read_rows(path)
    if missing := [name for name in columns if name not in header]:
        raise UserError(f"{path} has no column {', '.join(missing)}: not a file of a sweep")
    table = []
    for line, row in enumerate(rows, 2):
        if len(row) != len(header):
            raise UserError(f"{path}, row {line}: {len(row)} fields, the header has {len(header)}")
        fields = dict(zip(header, row, strict=True))
        table.append((f"{path}, row {line}", {name: fields[name] for name in columns}))
    return table


def _number(where: str, name: str, text: str) -> float:
    try:
        return float(text) if text else math.nan
    except ValueError:
        raise UserError(f"{where}: {name} is '{text}', not a number") from None
