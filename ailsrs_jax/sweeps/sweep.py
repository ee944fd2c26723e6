"""Many runs: a declarative grid of cells, trained until all are finished."""

import hashlib
import json
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol

from ailsrs_jax.errors import InUseError, UserError, one_line
from ailsrs_jax.files import read_json_object, write_atomically
from ailsrs_jax.runs.loop import Result, execute
from ailsrs_jax.runs.storage.metrics import IterationReport
from ailsrs_jax.runs.storage.trackers import require_tracker
from ailsrs_jax.sweeps.cells import Cell, Sweep
from ailsrs_jax.sweeps.estimate import estimated_env_steps
from ailsrs_jax.sweeps.launch import run_on_ray
from ailsrs_jax.sweeps.results import DONE, NOT_RUN
from ailsrs_jax.sweeps.spec import MOST_CELLS, expand, read_spec
from ailsrs_jax.sweeps.tables import (
    RESULT_FILE,
    TableRow,
    failed_row,
    finished_row,
    load_result,
    save_result,
    timing_row,
    write_tables,
)

SWEEP_FILE = "sweep.json"
MAX_PARALLEL = 64  # cells in one program; whatever the machine, so that all shards agree

STACK_FILE = "cells.json"  # in the directory of an unfinished stack
CHECKPOINTS = "checkpoints/*"  # of a stack or a cell

LAUNCHERS = ("local", "ray")

Unit = tuple[Cell, ...]  # what is trained as one program


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
    shard: tuple[int, int] = (0, 1),
    max_parallel: int = MAX_PARALLEL,
    launcher: str = "local",
    track: str | None = None,
    watch: SweepWatch | None = None,
) -> list[TableRow]:
    """Train every cell of a grid that is not finished yet, and write the tables.

    A cell that fails does not stop the others; the next call tries it again.

    >>> import ailsrs_jax as ail
    >>> short = {"num_iterations": 2, "episode_length": 100}
    >>> cloning = {"algorithm": "bc", "num_trajectories": [1, 2], "settings": short}
    >>> rows = ail.sweep({"env": "swimmer", "episodes": 2, "grid": [cloning]}, "runs/cloning")
    >>> [row["status"] for row in rows]
    ['done', 'done']

    Args:
        spec: a TOML file, or what it would hold.
        output: the directory of the sweep, where an earlier call may have left off.
        shard: I and N, to train only the I-th of N parts, I from 0.
        max_parallel: train at most so many cells at the same time, as one program.
        launcher: ``local``, one program after the other on this machine, or ``ray``, on a cluster.
        track: ``wandb`` or ``trackio``, to follow the metrics there too, as docs/tracking.md says.
        watch: is told how it goes.

    Returns:
        The rows of ``results.csv``, a cell each. One whose status is ``not run``, as of another
        shard, or begins with ``failed:`` says nothing else of what came of it.

    Raises:
        UserError: the spec is wrong, or the directory holds another sweep or cannot be written.
    """
    grid = expand(spec if isinstance(spec, Mapping) else read_spec(Path(spec)))
    require_launcher(launcher)
    require_tracker(track)
    units = choose_units(grid, shard, max_parallel)
    output = Path(output)
    grid.save(output / SWEEP_FILE)
    return run_units(grid, pending(units, output), output, launcher, track, watch)


def require_launcher(name: str) -> None:
    """Raise UserError unless there is such a launcher."""
    if name not in LAUNCHERS:
        raise UserError(f"unknown launcher '{name}': use {' or '.join(LAUNCHERS)}")


def choose_units(grid: Sweep, shard: tuple[int, int], max_parallel: int) -> list[Unit]:
    """The units of one shard: the same for the same arguments, and together all of the grid.

    The dearest units are dealt out first, each to the shard that has the least to do.

    Raises:
        UserError: there is no such shard, or nothing may run.
    """
    index, count = shard
    if not 0 <= index < count <= MOST_CELLS:
        raise UserError(
            f"shard {index}/{count}: write I/N with I from 0 to N - 1, and N at most {MOST_CELLS}"
        )
    if max_parallel < 1:
        raise UserError(f"max_parallel is {max_parallel}: it must be at least 1")
    programs: dict[str, list[Cell]] = {}
    for cell in grid.cells:
        programs.setdefault(cell.program, []).append(cell)
    units: list[Unit] = []
    for cells in programs.values():
        size = 1 if cells[0].engine == "mujoco" else max_parallel
        units += [tuple(cells[start : start + size]) for start in range(0, len(cells), size)]
    costs = [sum(map(estimated_env_steps, unit)) for unit in units]
    loads, mine = [0] * count, []
    for number in sorted(range(len(units)), key=lambda number: -costs[number]):
        lightest = loads.index(min(loads))
        loads[lightest] += costs[number]
        if lightest == index:
            mine.append(number)
    return [units[number] for number in sorted(mine)]


def pending(units: Sequence[Unit], output: Path) -> list[Unit]:
    """Those of which anything is not finished."""
    return [unit for unit in units if not all(is_done(output, cell) for cell in unit)]


def is_done(output: Path, cell: Cell) -> bool:
    """Whether a cell is finished."""
    result = load_result(output / "cells" / cell.name)
    return result is not None and result[0]["status"] == DONE


def run_units(
    grid: Sweep,
    units: Sequence[Unit],
    output: Path,
    launcher: str = "local",
    track: str | None = None,
    watch: SweepWatch | None = None,
    stop: Callable[[], bool] = lambda: False,
) -> list[TableRow]:
    """Train ``units``, and return the rows of ``results.csv``.

    On this machine ``stop`` is asked after every iteration; if true, what is trained is saved and
    KeyboardInterrupt raised.
    """
    require_same_stacks(units, output)
    rows = write_tables(output, grid.cells)
    if launcher == "local":
        for unit in units:
            if stop():  # during the last evaluation of the unit before
                raise KeyboardInterrupt
            run_unit(unit, output, grid.episodes, track, watch, stop)
            rows = write_tables(output, grid.cells)
        return rows
    left = {cell.name for unit in units for cell in unit if not is_done(output, cell)}
    for unit, problem in run_on_ray(run_unit, units, output, grid.episodes, track):
        for cell in unit:
            if problem is not None and not is_done(output, cell):
                save_result(output / "cells" / cell.name, failed_row(cell, problem), None)
        rows = write_tables(output, grid.cells)
        ended = left.intersection(cell.name for cell in unit)
        for row in rows:
            if watch is not None and row["cell"] in ended and row["status"] != NOT_RUN:
                watch.end(row)
    return rows


def run_unit(
    unit: Unit,
    output: Path,
    episodes: int,
    track: str | None,
    watch: SweepWatch | None = None,
    stop: Callable[[], bool] = lambda: False,
) -> None:
    """Train cells together, or go on with them, and evaluate what they have kept."""
    cells = [cell for cell in unit if not is_done(output, cell)]
    if not cells:
        return  # another process has finished them meanwhile
    stack_directory = _stack_directory(output, unit)
    for group in _groups(unit, cells, output):
        # Others may be at it, too, and what a stack has finished is still in its checkpoint.
        waiting = [cell for cell in group if not is_done(output, cell)]
        if not waiting:
            continue
        if watch is not None:
            watch.begin(waiting)
        outcomes: Sequence[Result | Exception]
        try:
            outcomes = _train(group, output, stack_directory, track, watch, stop)
        except Exception as error:  # of whatever kind: the others can still be trained
            outcomes = [error] * len(group)
        for cell, outcome in zip(group, outcomes, strict=True):
            if cell in waiting:
                _finish(cell, outcome, output, episodes, watch, stop)
    if not pending([unit], output):
        shutil.rmtree(stack_directory, ignore_errors=True)  # each cell has its own checkpoint


def _finish(
    cell: Cell,
    outcome: Result | Exception,
    output: Path,
    episodes: int,
    watch: SweepWatch | None,
    stop: Callable[[], bool],
) -> None:
    """Evaluate what a cell has kept, or note why it has failed."""
    if stop():  # an evaluation takes its time
        raise KeyboardInterrupt
    directory, timing = output / "cells" / cell.name, None
    try:
        if isinstance(outcome, Exception):
            raise outcome
        row = finished_row(cell, outcome, directory, episodes)
        timing = timing_row(cell, row, directory)
    except Exception as error:
        row = failed_row(cell, str(error) if isinstance(error, UserError) else one_line(error))
    if not isinstance(outcome, InUseError):  # who is at it will say what came of it
        save_result(directory, row, timing)
    if watch is not None:
        watch.end(row)


def _stack_directory(output: Path, unit: Unit) -> Path:
    names = "".join(cell.name for cell in unit)
    return output / "stacks" / hashlib.sha256(names.encode()).hexdigest()[:16]


def _begun_together(stack_directory: Path) -> list[str]:
    """Which cells a stack began with; none if it has no checkpoint, so that nothing is lost.

    Raises:
        UserError: the file is damaged.
    """
    path = stack_directory / STACK_FILE
    if not path.exists() or not any(stack_directory.glob(CHECKPOINTS)):
        return []
    names = read_json_object(path, "of a stack; delete its directory").get("cells")
    return [name for name in names if isinstance(name, str)] if isinstance(names, list) else []


def begun_stacks(output: Path) -> Iterator[tuple[Path, list[str]]]:
    """The directory of each stack that a sweep has begun, and which cells it began with."""
    for directory in (output / "stacks").glob("*"):
        yield directory, _begun_together(directory)


def require_same_stacks(units: Sequence[Unit], output: Path) -> None:
    """Raise UserError if cells have begun to be trained together otherwise than in ``units``.

    They are as far as that stack is, and its checkpoint is the only one that they have.
    """
    mine = {_stack_directory(output, unit) for unit in units}
    names = {cell.name for unit in units for cell in unit}
    for directory, begun in begun_stacks(output):
        if directory not in mine and names.intersection(begun):
            raise UserError(
                f"{directory} holds cells that are trained together, begun with another "
                "--max-parallel: go on with that, or delete it to begin them anew"
            )


def _groups(unit: Unit, pending: Sequence[Cell], output: Path) -> list[list[Cell]]:
    """The pending cells of ``unit``, each group to be trained together.

    Those that an unfinished stack began with go on together; of these some may be finished by now,
    but they are still in its checkpoint. Who has a checkpoint of its own goes on alone.
    """
    stack_directory = _stack_directory(output, unit)
    begun = _begun_together(stack_directory)
    if begun:
        together = [cell for cell in unit if cell.name in begun]
    else:
        together = [
            cell for cell in pending if not any((output / "cells" / cell.name).glob(CHECKPOINTS))
        ]
        if len(together) > 1:
            text = json.dumps({"cells": [cell.name for cell in together]})
            write_atomically(stack_directory / STACK_FILE, lambda file: file.write(text.encode()))
    alone = [[cell] for cell in pending if cell not in together]
    return [*alone, together] if together else alone


def _train(
    unit: Sequence[Cell],
    output: Path,
    stack_directory: Path,
    track: str | None,
    watch: SweepWatch | None,
    stop: Callable[[], bool],
) -> list[Result | UserError]:
    plans = [cell.make_plan() for cell in unit]
    directories = [output / "cells" / cell.name for cell in unit]
    for directory in directories:
        if not (directory / "config.json").exists():
            (directory / RESULT_FILE).unlink(missing_ok=True)  # it has failed before it began
    return execute(
        plans,
        directories,
        checkpoints=stack_directory / "checkpoints" if len(unit) > 1 else None,
        resume="where begun",
        track=track,
        watch=watch,
        stop=stop,
    )
