"""Train the cells of a sweep: which are trained together, and what is left to do."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from ailsrs_jax.envs.gymnasium_env import GymnasiumEnv
from ailsrs_jax.errors import UserError, one_line, refusing
from ailsrs_jax.own_code import allow
from ailsrs_jax.runs.storage.trackers import require_tracker
from ailsrs_jax.sweeps.cells import Cell, Sweep
from ailsrs_jax.sweeps.estimate import estimated_env_steps
from ailsrs_jax.sweeps.results import NOT_RUN
from ailsrs_jax.sweeps.spec import MAX_CELLS, expand, read_spec
from ailsrs_jax.sweeps.stacks import begun_stacks, stack_directory
from ailsrs_jax.sweeps.tables import TableRow, failed_row, save_row, write_tables
from ailsrs_jax.sweeps.unit import SweepWatch, Unit, is_done, pending, run_unit

SWEEP_FILE = "sweep.json"
MAX_PARALLEL = 64  # cells in one program; the same on every machine, so that all shards agree

LAUNCHERS = ("local", "ray")
RAY_RETRIES = 10  # of a unit whose worker is lost; each resumes from the newest checkpoint


def sweep(
    spec: str | Path | Mapping[str, Any],
    output: str | Path,
    *,
    shard: tuple[int, int] = (0, 1),
    max_parallel: int = MAX_PARALLEL,
    launcher: str = "local",
    track: str | None = None,
    watch: SweepWatch | None = None,
    own: Iterable[str] = (),
) -> list[TableRow]:
    """Train every cell of a grid that is not finished yet, and write the tables.

    A cell that fails does not stop the others. The next call tries it again.

    >>> import ailsrs_jax as ail
    >>> short = {"num_iterations": 2, "episode_length": 100}
    >>> cloning = {"algorithm": "bc", "num_trajectories": [1, 2], "settings": short}
    >>> rows = ail.sweep({"env": "swimmer", "episodes": 2, "grid": [cloning]}, "runs/cloning")
    >>> [row["status"] for row in rows]
    ['done', 'done']

    Args:
        spec: a TOML file, or its content as a dictionary.
        output: the directory of the sweep, which may hold the results of an earlier call.
        shard: (I, N) to train only the I-th of N parts, counted from 0.
        max_parallel: the maximum number of cells that are trained together, as one program.
        launcher: ``local`` to train one program after the other on this machine, or ``ray`` to
            train on a cluster.
        track: ``wandb`` or ``trackio``, to send the metrics there too; see docs/tracking.md.
        watch: an observer of the progress.
        own: names of your own code that the file may name: environments, algorithms, rewards and
            losses, each ``module:attribute``. Other code in a file is not imported.

    Returns:
        The rows of ``results.csv``, one for each cell. If the status is ``not run``, as for cells
        of another shard, or begins with ``failed:``, there are no results in the row.

    Raises:
        UserError: the spec is wrong, or the directory holds another sweep or cannot be written.
    """
    allow(*own)
    grid = expand(spec if isinstance(spec, Mapping) else read_spec(Path(spec)))
    require_launcher(launcher)
    require_tracker(track)
    units = choose_units(grid, shard, max_parallel)
    output = Path(output)
    grid.save(output / SWEEP_FILE)
    return run_units(grid, pending(units, output), output, launcher, track, watch)


def require_launcher(name: str) -> None:
    """Raise UserError unless a launcher has this name."""
    if name not in LAUNCHERS:
        raise UserError(f"unknown launcher '{name}': use {' or '.join(LAUNCHERS)}")


def choose_units(grid: Sweep, shard: tuple[int, int], max_parallel: int) -> list[Unit]:
    """Choose the units of a shard; the same arguments always give the same units.

    Units are dealt out by decreasing cost, each to the shard with the least work so far.

    Raises:
        UserError: the shard does not exist, or ``max_parallel`` is not positive.
    """
    index, count = shard
    if not 0 <= index < count <= MAX_CELLS:
        raise UserError(
            f"shard {index}/{count}: write I/N with I from 0 to N - 1, and N at most {MAX_CELLS}"
        )
    if max_parallel < 1:
        raise UserError(f"max_parallel is {max_parallel}: it must be at least 1")
    programs: dict[str, list[Cell]] = {}
    for cell in grid.cells:
        programs.setdefault(cell.program, []).append(cell)
    units: list[Unit] = []
    for cells in programs.values():
        in_jax = cells[0].engine not in ("mujoco", GymnasiumEnv.backend)  # which use all cores
        size = max_parallel if in_jax else 1
        units += [tuple(cells[start : start + size]) for start in range(0, len(cells), size)]
    costs = [sum(map(estimated_env_steps, unit)) for unit in units]
    loads, mine = [0] * count, []
    for number in sorted(range(len(units)), key=lambda number: -costs[number]):
        lightest = loads.index(min(loads))
        loads[lightest] += costs[number]
        if lightest == index:
            mine.append(number)
    return [units[number] for number in sorted(mine)]


def run_units(
    grid: Sweep,
    units: Sequence[Unit],
    output: Path,
    launcher: str = "local",
    track: str | None = None,
    watch: SweepWatch | None = None,
    stop: Callable[[], bool] = lambda: False,
) -> list[TableRow]:
    """Train ``units`` and return the rows of ``results.csv``.

    The local launcher calls ``stop`` after every iteration. If it returns true, the state of the
    training is saved and KeyboardInterrupt raised.
    """
    require_same_stacks(units, output)
    rows = write_tables(output, grid.cells)
    if launcher == "local":
        for unit in units:
            if stop():  # a signal may have arrived during the last evaluation
                raise KeyboardInterrupt
            run_unit(unit, output, grid.episodes, track, watch, stop)
            rows = write_tables(output, grid.cells)
        return rows
    left = {cell.name for unit in units for cell in unit if not is_done(output, cell)}
    for unit, problem in _run_on_ray(units, output, grid.episodes, track):
        for cell in unit:
            if problem is not None and not is_done(output, cell):
                save_row(output / "cells" / cell.name, failed_row(cell, problem), None)
        rows = write_tables(output, grid.cells)
        ended = left.intersection(cell.name for cell in unit)
        for row in rows:
            if watch is not None and row["cell"] in ended and row["status"] != NOT_RUN:
                watch.end(row)
    return rows


def _run_on_ray(
    units: Sequence[Unit], output: Path, episodes: int, track: str | None
) -> Iterator[tuple[Unit, str | None]]:
    """Run ``units`` on the Ray cluster at ``RAY_ADDRESS``, or on this machine if it is not set.

    A unit gets one GPU, or all cores of a node if the cluster has no GPU. All nodes have to see the
    working directory, ``output`` and the files of demonstrations under the same paths.

    Yields:
        Each unit when it has ended, and the reason if it could not be run.

    Raises:
        UserError: Ray is not installed, or the cluster does not answer.
    """
    try:
        import ray
    except ImportError:
        raise UserError("--launcher ray needs pip install 'ailsrs_jax[ray]'") from None
    with refusing("cannot connect to a Ray cluster"):
        ray.init(log_to_driver=False)
    try:
        nodes = [node["Resources"] for node in ray.nodes() if node["Alive"]]
        resources = {"num_cpus": min(node["CPU"] for node in nodes if "CPU" in node)}
        if any("GPU" in node for node in nodes):
            resources = {"num_gpus": 1}
        remote = ray.remote(max_retries=RAY_RETRIES, **resources)(run_unit)
        running = {remote.remote(unit, output.absolute(), episodes, track): unit for unit in units}
        while running:
            (ended,), _ = ray.wait(list(running))
            unit, problem = running.pop(ended), None
            try:
                ray.get(ended)
            except ray.exceptions.RayTaskError as error:
                problem = one_line(error.cause)
            except ray.exceptions.RayError as error:
                problem = f"all its workers were lost: {one_line(error)}"
            yield unit, problem
    finally:
        ray.shutdown()


def require_same_stacks(units: Sequence[Unit], output: Path) -> None:
    """Raise UserError if unfinished cells belong to a stack that is not in ``units``.

    The checkpoint of that stack is the only one that they have.
    """
    mine = {stack_directory(output, unit) for unit in units}
    names = {cell.name for unit in units for cell in unit}
    for directory in begun_stacks(output, names):
        if directory not in mine:
            raise UserError(
                f"{directory} holds cells that are trained together, begun with another "
                "--max-parallel: use that one again, or delete the directory to train them anew"
            )
