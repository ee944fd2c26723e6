"""Compare runs by their own records."""

import dataclasses
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ailsrs_jax.errors import UserError
from ailsrs_jax.runs.storage.metrics import read_metrics, share_of
from ailsrs_jax.runs.storage.saved_run import SavedRun, read_run

LEVEL = 0.9  # of the expert's return
POINTS = 18  # of a course


@dataclasses.dataclass(frozen=True)
class RunSummary:
    """The records of one run, over its seeds."""

    directory: str
    algorithm: str  #: its title
    num_seeds: int
    return_mean: float  #: of the kept policies, each by the evaluation that it was kept for
    expert_return: float | None  #: if its episodes were as long as those of the run
    distance: float | None  #: mean of the kept policies' energy distances to the expert
    steps_to_90: float | None  #: median of each seed's environment steps; infinite if most lack it
    seconds_to_90: float | None  #: the median with compilation; several seeds share the time
    course: tuple[float, ...]  #: mean evaluation return at times that all compared runs share


@dataclasses.dataclass(frozen=True)
class Comparison:
    """Runs of one task."""

    env_id: str
    max_steps: int  #: of a seed, where the courses end
    runs: tuple[RunSummary, ...]


def compare_runs(directories: Sequence[Path]) -> Comparison:
    """Compare runs of one task by their records.

    Raises:
        UserError: there is no directory, one holds no run that has kept a policy, or the runs are
            of several tasks.
    """
    if not directories:
        raise UserError("name the directories of the runs to compare")
    saved = [read_run(directory) for directory in directories]
    tasks = {run.config["env_id"] for run in saved}
    if len(tasks) > 1:
        raise UserError(f"these are runs of several tasks: {', '.join(sorted(tasks))}")
    max_steps = max(int(run.metrics["env_steps"].max()) for run in saved)
    times = np.linspace(max_steps / POINTS, max_steps, POINTS)
    return Comparison(tasks.pop(), max_steps, tuple(_summary(run, times) for run in saved))


def _summary(run: SavedRun, grid: np.ndarray) -> RunSummary:
    expert = run.comparable_expert_return
    times = run.directory / "seconds.csv"
    table = read_metrics(times)
    if not {"seconds", "compile_seconds"} <= set(table):
        raise UserError(f"{times} does not have the columns seconds and compile_seconds")
    clock = np.cumsum(table["seconds"] + table["compile_seconds"])
    returns, distances, reached, courses = [], [], [], []
    for _, mine, row in run.kept_rows():
        steps, course = mine["env_steps"], mine["evaluation_return"]
        returns.append(course[row])
        distances.append(mine.get("expert_distance", course * np.nan)[row])
        courses.append(course[np.clip(np.searchsorted(steps, grid, "right") - 1, 0, None)])
        if expert is not None:
            # A run that was killed may lack the time of its last iteration.
            above = np.flatnonzero(course[: len(clock)] >= share_of(expert, LEVEL))
            reached.append((steps[above[0]], clock[above[0]]) if above.size else (np.inf, np.inf))
    if not returns:
        raise UserError(f"{run.directory} has kept no policy yet")
    steps_to, seconds_to = np.median(reached, axis=0).tolist() if reached else (None, None)
    return RunSummary(
        directory=str(run.directory),
        algorithm=run.title,
        num_seeds=len(returns),
        return_mean=float(np.mean(returns)),
        expert_return=expert,
        distance=float(np.mean(distances)) if run.imitates else None,
        steps_to_90=steps_to,
        seconds_to_90=seconds_to,
        course=tuple(np.mean(courses, axis=0).tolist()),
    )
