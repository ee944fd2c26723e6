"""The statistics of a sweep: groups of seeds, interquartile means, intervals, profiles.

Aggregates over tasks follow Agarwal et al., "Deep Reinforcement Learning at the Edge of the
Statistical Precipice", NeurIPS 2021. SciPy computes them and not rliable 1.2, which ignores the
random state that it is given, wants as many seeds on every task, and does not import with pandas 3.
"""

import dataclasses
import math
from collections.abc import Callable, Hashable, Iterable, Sequence
from typing import Any

import numpy as np
from scipy import ndimage, stats

from ailsrs_jax.sweeps.results import CellResult, Curve

CONFIDENCE = 0.95
NUM_RESAMPLES = 5000
THRESHOLDS = np.linspace(0, 1.2, 121)  # of the performance profiles


@dataclasses.dataclass(frozen=True)
class Estimate:
    """A number, or an array of them, and the ends of its 95 % interval, NaN where there is none."""

    value: Any
    low: Any
    high: Any


@dataclasses.dataclass(frozen=True)
class Group:
    """The cells that differ in their seed only."""

    series: str  # what it is called in tables and figures
    cells: tuple[CellResult, ...]  # those done, at least one
    num_planned: int  # those done, and those not

    @property
    def env_id(self) -> str:
        """The task."""
        return self.cells[0].env_id

    @property
    def num_trajectories(self) -> int | None:
        """The number of demonstrations, if it learns from any."""
        return self.cells[0].num_trajectories

    @property
    def condition(self) -> tuple[str, int | None]:
        """What other series can be compared with it on."""
        return self.env_id, self.num_trajectories

    @property
    def has_comparable_curves(self) -> bool:
        """Whether what training measured is of episodes of the task's length."""
        return bool(np.isfinite(self.values("mean_return_over_training")).any())

    def values(self, name: str) -> np.ndarray:
        """A number of each cell."""
        return np.array([getattr(cell, name) for cell in self.cells], float)


def series_names(cells: Iterable[CellResult]) -> dict[str, str]:
    """What each cell's series is called, by the cell's name.

    It is the label, with the algorithm where cells of that label on the same task differ in it, and
    with the preset, the settings, the engine, the demonstrations and how they are thinned out where
    cells with as many of them do.
    """
    cells = list(cells)
    variants: dict[tuple[Any, ...], set[tuple[str, ...]]] = {}
    for cell in cells:
        condition = (cell.label, cell.env_id, cell.num_trajectories)
        variants.setdefault(condition, set()).add(_variant(cell))
        # What learns from the reward has no number of demonstrations.
        variants.setdefault(condition[:2], set()).add(_variant(cell)[:1])
    differing: dict[str, set[int]] = {cell.label: set() for cell in cells}
    for (label, *_), same in variants.items():
        differing[label] |= {at for at, values in enumerate(zip(*same)) if len(set(values)) > 1}
    names = {}
    for cell in cells:
        parts = [part for at, part in enumerate(_variant(cell)) if at in differing[cell.label]]
        names[cell.cell] = cell.label + (f" ({', '.join(parts)})" if parts else "")
    return names


def _variant(cell: CellResult) -> tuple[str, ...]:
    return (
        cell.algorithm,
        cell.preset,
        cell.settings.replace(";", ", ") or "as preset",
        cell.physics,
        cell.demonstrations or "shipped expert",
        f"subsample={cell.subsample}",
    )


def group_cells(cells: Iterable[CellResult]) -> list[Group]:
    """The groups with at least one cell done, in the order of ``cells``."""
    cells = list(cells)
    names = series_names(cells)
    groups: dict[Hashable, list[CellResult]] = {}
    for cell in cells:
        key = (names[cell.cell], cell.env_id, cell.num_trajectories)
        groups.setdefault(key, []).append(cell)
    return [
        Group(names[mine[0].cell], done, len(mine))
        for mine in groups.values()
        if (done := tuple(cell for cell in mine if cell.done))
    ]


def comparable(groups: Iterable[Group]) -> dict[str, list[Group]]:
    """By series, the groups under the conditions that every series has been measured under.

    A condition is a task and a number of demonstrations. A series that has no demonstrations is
    compared on the tasks alone. Where there is no normalised return nothing has been measured.
    """
    groups = [group for group in groups if scores([group])]
    by_series: dict[str, list[Group]] = {}
    for group in groups:
        by_series.setdefault(group.series, []).append(group)
    tasks = _in_all({group.env_id for group in mine} for mine in by_series.values())
    conditions = _in_all(
        {group.condition for group in mine}
        for mine in by_series.values()
        if mine[0].num_trajectories is not None
    )
    return {
        series: [
            group
            for group in mine
            if group.env_id in tasks
            and (group.num_trajectories is None or group.condition in conditions)
        ]
        for series, mine in by_series.items()
    }


def _in_all(sets: Iterable[set[Any]]) -> set[Any]:
    sets = list(sets)
    return set.intersection(*sets) if sets else set()


def interquartile_mean(strata: Sequence[np.ndarray]) -> Estimate:
    """The mean of the middle half of all scores, with a stratified bootstrap interval.

    Args:
        strata: The scores (seeds,) of each group.
    """
    return bootstrap(strata, lambda scores: stats.trim_mean(scores, proportiontocut=0.25, axis=-1))


def performance_profile(strata: Sequence[np.ndarray]) -> Estimate:
    """The share of runs that score above each of ``THRESHOLDS``, with its intervals."""
    return bootstrap(
        strata, lambda scores: np.stack([(scores > t).mean(axis=-1) for t in THRESHOLDS])
    )


def bootstrap(
    strata: Sequence[np.ndarray], statistic: Callable[[np.ndarray], np.ndarray]
) -> Estimate:
    """A statistic of all scores, and its percentile interval when seeds are drawn anew.

    Seeds are drawn within each stratum, so that tasks keep their weight. One seed says nothing
    about others: with a stratum of one there is no interval.

    Args:
        strata: The scores (seeds,) of each group.
        statistic: Takes scores (..., runs) to (..., ) or (outputs, ...).
    """
    value = statistic(np.concatenate(strata))
    if min(map(len, strata)) < 2:
        nothing = np.full_like(value, np.nan)
        return Estimate(value, nothing, nothing)
    interval = stats.bootstrap(
        strata,
        lambda *samples, axis: statistic(np.concatenate(samples, axis=-1)),  # noqa: ARG005
        n_resamples=NUM_RESAMPLES,
        vectorized=True,
        axis=-1,
        confidence_level=CONFIDENCE,
        method="percentile",
        rng=0,  # the same figures from the same results
    ).confidence_interval
    return Estimate(value, interval.low, interval.high)


def scores(groups: Iterable[Group], name: str = "normalized") -> list[np.ndarray]:
    """The normalised scores (seeds,) of each group, without those that were not measured.

    Args:
        groups: A stratum each.
        name: ``normalized`` or ``normalized_over_training``.
    """
    measured = [group.values(name) for group in groups]
    measured = [values[np.isfinite(values)] for values in measured]
    return [values for values in measured if len(values)]


def mean_curve(curves: Sequence[Curve]) -> Curve:
    """The mean over seeds at each iteration that all of them have reached.

    An evaluation that diverged is left out; NaN where all did.
    """
    length = min(len(curve.iterations) for curve in curves)
    return Curve(
        *(
            np.ma.masked_invalid([getattr(curve, field.name)[:length] for curve in curves])
            .mean(axis=0)
            .filled(np.nan)
            for field in dataclasses.fields(Curve)
        )
    )


def smoothed(values: np.ndarray) -> np.ndarray:
    """A curve (iterations,) after a Gaussian filter a fiftieth of it wide, at least 1 iteration."""
    return ndimage.gaussian_filter1d(values, max(len(values) / 50, 1), mode="nearest")


def mean_std(values: np.ndarray) -> tuple[float, float]:
    """Mean and sample standard deviation, NaN of a single value."""
    return float(values.mean()), float(values.std(ddof=1)) if len(values) > 1 else math.nan


def median_reached(values: np.ndarray) -> tuple[float, int]:
    """The median over seeds, counting NaN (never) as infinite; and how many are not."""
    reached = np.isfinite(values)
    return float(np.median(np.where(reached, values, np.inf))), int(reached.sum())
