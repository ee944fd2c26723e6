"""The statistics of a sweep: groups of seeds, interquartile means, intervals and profiles.

Aggregates over tasks follow Agarwal et al., "Deep Reinforcement Learning at the Edge of the
Statistical Precipice", NeurIPS 2021. They are computed with SciPy because rliable 1.2 ignores its
random state, needs the same number of seeds on every task, and does not import with pandas 3.
"""

import dataclasses
import itertools
import math
from collections import defaultdict
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
    """A number or an array with the ends of its 95 % interval, NaN if there is no interval."""

    value: Any
    low: Any
    high: Any


@dataclasses.dataclass(frozen=True)
class Group:
    """Cells that differ only in their seed."""

    series: str  # the name of the group's line in tables and figures
    cells: tuple[CellResult, ...]  # the finished cells, at least one
    num_planned: int  # finished and unfinished cells

    @property
    def env_id(self) -> str:
        """The task."""
        return self.cells[0].env_id

    @property
    def num_trajectories(self) -> int | None:
        """The number of demonstrations; None for an algorithm that learns from the reward."""
        return self.cells[0].num_trajectories

    @property
    def condition(self) -> tuple[str, int | None]:
        """The task and the number of demonstrations, on which series can be compared."""
        return self.env_id, self.num_trajectories

    @property
    def has_comparable_curves(self) -> bool:
        """Whether training was evaluated on episodes of the task's own length."""
        return bool(np.isfinite(self.values("mean_return_over_training")).any())

    def values(self, name: str) -> np.ndarray:
        """Return the column ``name`` of each cell."""
        return np.array([getattr(cell, name) for cell in self.cells], float)


def series_names(cells: Iterable[CellResult]) -> dict[str, str]:
    """Return the name of each cell's series, by the cell's name.

    The name is the label, followed in brackets by whatever else is needed to tell series apart. The
    algorithm is added if cells with this label differ in it on one task. Preset, settings, engine
    and whatever else is known of the demonstrations are added if cells with this label differ in
    them on one task with the same number of demonstrations.
    """
    cells = list(cells)
    variants: dict[tuple[Any, ...], set[tuple[str, ...]]] = defaultdict(set)
    for cell in cells:
        variants[cell.label, cell.env_id, cell.num_trajectories].add(_variant(cell))
        # Algorithms that learn from the reward have no number of demonstrations.
        variants[cell.label, cell.env_id].add(_variant(cell)[:1])
    differing: dict[str, set[int]] = defaultdict(set)
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
        f"drawn from {cell.draw_from}" if cell.draw_from else "the first",
        f"subsample={cell.subsample}",
        "states alone" if cell.states_only else "with actions",
    )


def group_cells(cells: Iterable[CellResult]) -> list[Group]:
    """Return the groups with at least one finished cell, in the order of ``cells``."""
    cells = list(cells)
    names = series_names(cells)
    groups: dict[Hashable, list[CellResult]] = defaultdict(list)
    for cell in cells:
        groups[names[cell.cell], cell.env_id, cell.num_trajectories].append(cell)
    return [
        Group(names[mine[0].cell], done, len(mine))
        for mine in groups.values()
        if (done := tuple(cell for cell in mine if cell.done))
    ]


def comparable(groups: Sequence[Group]) -> dict[str, list[Group]]:
    """Return the groups of each series under the conditions that all series share.

    Groups without a normalized return are left out.
    """
    by_series = _measured(groups)
    shared = shared_conditions(groups)
    shared |= {(task, None) for task, _ in shared}
    return {
        series: [group for group in mine if group.condition in shared]
        for series, mine in by_series.items()
    }


def shared_conditions(groups: Sequence[Group]) -> set[tuple[str, int | None]]:
    """Return the conditions under which all series were measured.

    A condition is a task and a number of demonstrations. A series without demonstrations was
    measured under every condition of its tasks.
    """
    measured = [{group.condition for group in mine} for mine in _measured(groups).values()]
    return {
        (task, number)
        for task, number in set[tuple[str, int | None]]().union(*measured)
        if all({(task, number), (task, None)} & mine for mine in measured)
    }


def _measured(groups: Iterable[Group]) -> dict[str, list[Group]]:
    """Return the groups of each series that have a normalized return."""
    by_series: dict[str, list[Group]] = defaultdict(list)
    for group in groups:
        if scores([group]):
            by_series[group.series].append(group)
    return by_series


def shared_scores(
    mine: Iterable[Group], others: Iterable[Group]
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return the finite scores of two series, in pairs, under each condition that they share.

    A series without demonstrations was measured under every condition of its tasks.
    """
    pairs = [
        scores([one, other])
        for one, other in itertools.product(mine, list(others))
        if one.env_id == other.env_id
        and (one.condition == other.condition or None in (*one.condition, *other.condition))
    ]
    return [(pair[0], pair[1]) for pair in pairs if len(pair) == 2]


def interquartile_mean(strata: Sequence[np.ndarray]) -> Estimate:
    """Compute the mean of the middle half of all scores; for the interval see :func:`bootstrap`."""
    return bootstrap(strata, lambda scores: stats.trim_mean(scores, proportiontocut=0.25, axis=-1))


def probability_of_improvement(pairs: Sequence[tuple[np.ndarray, np.ndarray]]) -> Estimate:
    """Estimate P(X > Y) from the scores of X and Y in each condition; a tie counts half.

    It is the mean over conditions of the share of pairs of runs in which X scores higher.
    """
    strata = [scores for pair in pairs for scores in pair]
    ends = np.cumsum([len(scores) for scores in strata])[:-1]

    def probability(scores: np.ndarray) -> np.ndarray:
        samples = np.split(scores, ends, axis=-1)
        signs = [
            np.sign(x[..., :, None] - y[..., None, :]).mean(axis=(-2, -1))
            for x, y in zip(samples[::2], samples[1::2])
        ]
        return 0.5 + 0.5 * np.mean(signs, axis=0)

    return bootstrap(strata, probability)


def performance_profile(strata: Sequence[np.ndarray]) -> Estimate:
    """Compute the share of runs that score above each of ``THRESHOLDS``, with its interval."""
    return bootstrap(
        strata, lambda scores: np.stack([(scores > t).mean(axis=-1) for t in THRESHOLDS])
    )


def bootstrap(
    strata: Sequence[np.ndarray], statistic: Callable[[np.ndarray], np.ndarray]
) -> Estimate:
    """Compute a statistic of all scores and its percentile bootstrap interval over seeds.

    Seeds are resampled within each stratum, so that tasks keep their weight. There is no interval
    if a stratum has only one seed. ``strata`` are the scores (seeds,) of each group, and
    ``statistic`` is a function from scores (..., runs) to (...,) or (outputs, ...).
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
        rng=0,  # so that the same results give the same figures
    ).confidence_interval
    return Estimate(value, interval.low, interval.high)


def scores(groups: Iterable[Group], name: str = "normalized") -> list[np.ndarray]:
    """Return the finite scores (seeds,) of each group that has any, one stratum for each group.

    ``name`` is ``normalized`` or ``normalized_over_training``.
    """
    measured = [group.values(name) for group in groups]
    measured = [values[np.isfinite(values)] for values in measured]
    return [values for values in measured if len(values)]


def mean_curve(curves: Sequence[Curve]) -> Curve:
    """Compute the mean over seeds, up to the last iteration that all of them have reached.

    Evaluations that diverged are left out. The mean is NaN at an iteration where all diverged.
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
    """Smooth a curve (iterations,) with a Gaussian whose σ is 1/50 of its length, at least 1."""
    return ndimage.gaussian_filter1d(values, max(len(values) / 50, 1), mode="nearest")


def mean_std(values: np.ndarray) -> tuple[float, float]:
    """Compute the mean and the sample standard deviation, which is NaN for a single value."""
    return float(values.mean()), float(values.std(ddof=1)) if len(values) > 1 else math.nan


def median_reached(values: np.ndarray) -> tuple[float, int]:
    """Return the median over seeds with NaN (never reached) as infinity, and the finite count."""
    reached = np.isfinite(values)
    return float(np.median(np.where(reached, values, np.inf))), int(reached.sum())
