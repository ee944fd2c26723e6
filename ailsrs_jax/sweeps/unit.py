"""Train a unit of a sweep: cells that are one program, as a stack if there are several."""

import contextlib
import shutil
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Protocol

from ailsrs_jax.runs.loop import execute
from ailsrs_jax.runs.storage.directory import locked
from ailsrs_jax.runs.storage.journal import Result
from ailsrs_jax.runs.storage.metrics import IterationReport
from ailsrs_jax.sweeps.cells import Cell
from ailsrs_jax.sweeps.results import DONE
from ailsrs_jax.sweeps.stacks import split_unit, stack_directory
from ailsrs_jax.sweeps.tables import ROW_FILE, TableRow, finish, load_row

Unit = tuple[Cell, ...]


class SweepWatch(Protocol):
    """An observer of a sweep."""

    def begin(self, cells: Sequence[Cell]) -> None:
        """Take note that these cells are now trained together."""

    def __call__(self, report: IterationReport) -> None:
        """Take note of an iteration of these cells."""

    def end(self, row: TableRow) -> None:
        """Take note of the row of ``results.csv`` of a cell that has finished or failed."""


def pending(units: Sequence[Unit], output: Path) -> list[Unit]:
    """Return the units with a cell that is not finished."""
    return [unit for unit in units if not all(is_done(output, cell) for cell in unit)]


def is_done(output: Path, cell: Cell) -> bool:
    """Tell whether a cell has finished with a policy."""
    return load_row(output / "cells" / cell.name)[0].get("status") == DONE


def run_unit(
    unit: Unit,
    output: Path,
    episodes: int,
    track: str | None,
    watch: SweepWatch | None = None,
    stop: Callable[[], bool] = lambda: False,
) -> None:
    """Train the unfinished cells of a unit, and evaluate the policies that they have kept."""
    unfinished = [cell for cell in unit if not is_done(output, cell)]
    if not unfinished:
        return  # another process has finished them meanwhile
    for group in split_unit(unit, unfinished, output):
        stack = stack_directory(output, unit) if len(group) > 1 else None
        _run_group(group, stack, output, episodes, track, watch, stop)
    if not pending([unit], output):  # each cell has its own checkpoint now
        shutil.rmtree(stack_directory(output, unit), ignore_errors=True)


def _run_group(
    group: Sequence[Cell],
    stack: Path | None,
    output: Path,
    episodes: int,
    track: str | None,
    watch: SweepWatch | None,
    stop: Callable[[], bool],
) -> None:
    """Train a cell, or several whose shared checkpoint is in the directory ``stack``."""
    directories = [output / "cells" / cell.name for cell in group]
    # Cells of a stack that are finished still belong to its checkpoint.
    waiting = [cell for cell in group if not is_done(output, cell)]
    outcomes: Sequence[Result | Exception]
    with contextlib.ExitStack() as held:
        try:
            if stack is not None:  # to the last row, because another process would begin again
                held.enter_context(locked(stack))
                waiting = [cell for cell in waiting if not is_done(output, cell)]
            if not waiting:
                return
            if watch is not None:
                watch.begin(waiting)
            plans = [cell.make_plan() for cell in group]
            for directory in directories:
                if not (directory / "config.json").exists():  # it has failed before it began
                    (directory / ROW_FILE).unlink(missing_ok=True)
            outcomes = execute(
                plans,
                directories,
                checkpoints=None if stack is None else stack / "checkpoints",
                resume="where begun",
                track=track,
                watch=watch,
                stop=stop,
            )
        except Exception as error:  # of any kind, because the other cells can still be trained
            outcomes = [error] * len(group)
        for cell, directory, outcome in zip(group, directories, outcomes, strict=True):
            if cell in waiting:
                if stop():  # an evaluation takes time
                    raise KeyboardInterrupt
                row = finish(cell, outcome, directory, episodes)
                if watch is not None:
                    watch.end(row)
