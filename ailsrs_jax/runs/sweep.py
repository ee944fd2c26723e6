"""Many runs: a declarative grid of cells, trained until all are finished."""

import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol

from ailsrs_jax.errors import UserError, one_line
from ailsrs_jax.runs.run import execute
from ailsrs_jax.runs.sweep_spec import Cell, Sweep, expand, read_spec
from ailsrs_jax.runs.sweep_tables import (
    DONE,
    Stopwatch,
    TableRow,
    failed_row,
    finished_row,
    load_result,
    save_result,
    timing_row,
    write_tables,
)
from ailsrs_jax.runs.tracking import IterationReport

SWEEP_FILE = "sweep.json"


class SweepWatch(Protocol):
    """Who is told how a sweep goes."""

    def begin(self, cells: Sequence[Cell]) -> None:
        """These cells are trained from now on, together."""

    def __call__(self, report: IterationReport) -> None:
        """An iteration of them is done."""

    def end(self, row: TableRow) -> None:
        """One of them is finished, or has failed; this is its row of ``results.csv``."""


def sweep(
    spec: str | Path | Mapping[str, Any],
    output: str | Path,
    *,
    watch: SweepWatch | None = None,
) -> list[TableRow]:
    """Train every cell of a grid that is not finished yet, and write the tables.

    A cell that fails does not stop the others; the next call tries it again.

    Args:
        spec: a TOML file, or what it would hold.
        output: the directory of the sweep, where an earlier call may have left off.
        watch: is told how it goes.

    Returns:
        The rows of ``results.csv``.

    Raises:
        UserError: the spec is wrong, or the directory holds another sweep or cannot be written.
    """
    grid = expand(spec if isinstance(spec, Mapping) else read_spec(Path(spec)))
    output = Path(output)
    grid.save(output / SWEEP_FILE)
    return run_cells(grid, pending(grid.cells, output), output, watch)


def pending(cells: Sequence[Cell], output: Path) -> list[Cell]:
    """Those that are not finished."""
    return [cell for cell in cells if not _is_done(output / "cells" / cell.name)]


def run_cells(
    grid: Sweep, cells: Sequence[Cell], output: Path, watch: SweepWatch | None
) -> list[TableRow]:
    """Train ``cells``, and return the rows of ``results.csv``."""
    rows = write_tables(output, grid.cells)
    for cell in cells:
        if watch is not None:
            watch.begin([cell])
        row = run_cell(cell, output / "cells" / cell.name, grid.episodes, watch)
        if watch is not None:
            watch.end(row)
        rows = write_tables(output, grid.cells)
    return rows


def run_cell(cell: Cell, directory: Path, episodes: int, watch: SweepWatch | None) -> TableRow:
    """Train a cell, or go on with it, and evaluate what it has kept."""
    try:
        plan = cell.make_plan()
        started = (directory / "config.json").exists()
        if not started and directory.exists():
            shutil.rmtree(directory)  # killed before it began
        stopwatch = Stopwatch(directory)

        def tell(report: IterationReport) -> None:
            stopwatch(report)
            if watch is not None:
                watch(report)

        result = execute(plan, directory, resume=started, watch=tell)
        row = finished_row(cell, plan.config, result, directory, episodes)
        timing = timing_row(cell, row, directory)
    except Exception as error:  # of whatever kind: the others can still be trained
        reason = str(error) if isinstance(error, UserError) else one_line(error)
        row, timing = failed_row(cell, reason), None
    save_result(directory, row, timing)
    return row


def _is_done(directory: Path) -> bool:
    result = load_result(directory)
    return result is not None and result[0]["status"] == DONE
