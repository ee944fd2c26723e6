"""The results of a sweep: the columns of its three tables, and reading them as typed objects."""

import dataclasses
import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, TypeVar, get_type_hints

import numpy as np

from ailsrs_jax.errors import UserError, requirement
from ailsrs_jax.runs.storage.metrics import read_rows

DONE = "done"
NOT_RUN = "not run"

RowT = TypeVar("RowT")


@dataclasses.dataclass(frozen=True)
class CellResult:
    """One row of ``results.csv``: an algorithm on a task with one seed. An empty number is NaN."""

    cell: str  # the cell's name
    label: str  # of the cell's entry in the sweep file
    algorithm: str
    env_id: str
    preset: str
    settings: str  # settings that differ from the preset, as NAME=VALUE;NAME=VALUE
    demonstrations: str  # empty for those of the shipped expert
    num_trajectories: int | None  # None for an algorithm that learns from the reward
    draw_from: int | None  # the demonstrations are drawn from so many; None: they are the first
    subsample: int  # every subsample-th step of the demonstrations is used
    states_only: bool  # without the actions of the demonstrations
    seed: int
    physics: str
    iterations: float
    env_steps: float  # live steps of training
    kept_iteration: float
    return_mean: float  # of the kept policy in Gymnasium's environment, like the next two
    return_std: float  # over episodes
    length_mean: float
    last_return: float  # of the last iteration's policy
    mean_return_over_training: float
    steps_to_90: float  # live steps until 0.9 of the expert's return; NaN if never reached
    expert_return: float  # NaN if the task has no expert
    random_return: float
    normalized: float  # return_mean as a score: 0 is a random policy, 1 is the expert
    status: str  # DONE, NOT_RUN or "failed: reason"

    @property
    def done(self) -> bool:
        """Whether the cell has finished with a policy."""
        return self.status == DONE

    @property
    def normalized_over_training(self) -> float:
        """``mean_return_over_training`` as a score: 0 is a random policy, 1 is the expert."""
        return self.normalize(self.mean_return_over_training)

    def normalize(self, returns: Any) -> Any:
        """Convert returns to scores of the same shape: (return − random) / (expert − random)."""
        scale = self.expert_return - self.random_return
        return (returns - self.random_return) / (scale or math.nan)


@dataclasses.dataclass(frozen=True)
class Curve:
    """The learning curve of a cell: one array element for each iteration, NaN if it is empty."""

    iterations: np.ndarray
    env_steps: np.ndarray
    returns: np.ndarray  # of the evaluation episodes

    def steps_to(self, level: float) -> float:
        """Return the steps after which evaluation episodes first returned ``level``; NaN: never."""
        reached = np.flatnonzero(self.returns >= level)
        return float(self.env_steps[reached[0]]) if len(reached) else math.nan


@dataclasses.dataclass(frozen=True)
class Timing:
    """The wall-clock times of a cell [s]. An empty number is NaN."""

    train_seconds: float
    compile_seconds: float
    seconds_to_90_percent: float  # NaN if never reached
    hardware: str


@dataclasses.dataclass(frozen=True)
class SweepResults:
    """The results of a sweep. Failed cells may lack a curve and a timing."""

    cells: tuple[CellResult, ...]  # in the order of the sweep
    curves: dict[str, Curve]  # by cell name
    timings: dict[str, Timing]  # by cell name

    @property
    def done(self) -> list[CellResult]:
        """The cells that have finished with a policy."""
        return [cell for cell in self.cells if cell.done]


_CURVE = ("iteration", "env_steps", "evaluation_return")  # the arrays of a Curve
COLUMNS = {  # of each table, by the name of its file
    "results.csv": tuple(get_type_hints(CellResult)),
    "curves.csv": (
        *("cell", *_CURVE, "evaluation_length"),
        *("expert_distance", "imitation_reward", "policy_score", "expert_score"),
    ),
    "timings.csv": ("cell", *get_type_hints(Timing)),
}

# A finished cell has a finite number in each of these columns.
_MEASURED = (
    *("iterations", "env_steps", "kept_iteration", "return_mean", "return_std", "length_mean"),
    "random_return",
)


def read_results(directory: Path) -> SweepResults:
    """Read the three tables in the directory of a sweep, or of committed results.

    Raises:
        UserError: a table cannot be read, lacks a column, or holds a wrong or missing value.
    """
    cells: dict[str, CellResult] = {}
    for where, row in read_table(directory / "results.csv", COLUMNS["results.csv"]):
        cell = _parse(CellResult, where, row)
        if cell.cell in cells:
            raise UserError(f"{where}: cell {cell.cell} is there twice")
        for name in _MEASURED:
            if cell.done and not math.isfinite(getattr(cell, name)):
                raise UserError(f"{where}: {name} of a cell that is done is '{row[name]}'")
        cells[cell.cell] = cell
    curves: dict[str, list[list[float]]] = {}
    for where, row in read_table(directory / "curves.csv", ("cell", *_CURVE)):
        curves.setdefault(row["cell"], []).append([_number(where, x, row[x]) for x in _CURVE])
    timings = {
        row["cell"]: _parse(Timing, where, row)
        for where, row in read_table(directory / "timings.csv", COLUMNS["timings.csv"])
    }
    return SweepResults(
        cells=tuple(cells.values()),
        curves={name: Curve(*np.array(values).T) for name, values in curves.items()},
        timings=timings,
    )


def read_table(path: Path, columns: Sequence[str]) -> Iterator[tuple[str, dict[str, str]]]:
    """Yield where each row of a CSV file is, for error messages, and its fields by column.

    Raises:
        UserError: the file cannot be read, lacks one of ``columns``, or is ragged.
    """
    header, *rows = read_rows(path)
    if missing := [name for name in columns if name not in header]:
        raise UserError(f"{path} has no column {', '.join(missing)}: it is not a table of a sweep")
    for line, row in enumerate(rows, 2):
        if len(row) != len(header):
            raise UserError(f"{path}, row {line}: {len(row)} fields, the header has {len(header)}")
        yield f"{path}, row {line}", dict(zip(header, row, strict=True))


def _parse(kind: type[RowT], where: str, row: dict[str, str]) -> RowT:
    """Build a dataclass from a row of text, each field by its type."""
    types = get_type_hints(kind)
    return kind(**{name: _value(where, name, row[name], types[name]) for name in types})


def _value(where: str, name: str, text: str, kind: Any) -> str | float | None:
    if kind is str:
        return text
    if kind is bool:
        requirement(where)(text in ("True", "False"), f"{name} is '{text}', not True or False")
        return text == "True"
    number = _number(where, name, text)
    if kind is float:
        return number
    if math.isnan(number) and kind is not int:
        return None
    require = requirement(where)
    require(not math.isnan(number), f"there is no {name}")
    require(number % 1 == 0, f"{name} is '{text}', not a whole number")
    return int(number)


def _number(where: str, name: str, text: str) -> float:
    try:
        return float(text) if text else math.nan
    except ValueError:
        raise UserError(f"{where}: {name} is '{text}', not a number") from None
