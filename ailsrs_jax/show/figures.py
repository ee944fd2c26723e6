"""The figures of a sweep, drawn from its tables alone."""

import itertools
import re
import textwrap
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from matplotlib import style
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ailsrs_jax.files import write_atomically
from ailsrs_jax.show.style import (
    COLORS,
    EXPERT,
    LINES,
    MARKERS,
    RANDOM,
    STYLE,
    WIDTH,
    add_legend,
    encoded,
    legend_label,
    panels,
)
from ailsrs_jax.sweeps.results import SweepResults
from ailsrs_jax.sweeps.statistics import (
    THRESHOLDS,
    Group,
    comparable,
    group_cells,
    interquartile_mean,
    mean_curve,
    mean_std,
    performance_profile,
    scores,
    smoothed,
)

LONGEST_SLUG = 100  # characters of a series in the name of a file
NUMBERS_OF_SEEDS = (1, 3, 5)  # as in the paper's Figure 3
MEASURES = {"normalized": "kept policy", "normalized_over_training": "mean over training"}

T = TypeVar("T")
Looks = dict[str, dict[str, Any]]  # colour, marker and line style of each series


def save_figures(results: SweepResults, directory: Path) -> None:
    """Write every figure as PNG and PDF; the same results give the same bytes."""
    for name, figure in draw_figures(results).items():
        for kind in ("png", "pdf"):
            with style.context(STYLE):
                write_atomically(directory / f"{name}.{kind}", encoded(figure, kind))


def draw_figures(results: SweepResults) -> dict[str, Figure]:
    """Draw every figure for which there are results, by its name."""
    groups = group_cells(results.cells)
    looks = looks_of(groups)
    with style.context(STYLE):
        drawn = {
            "figure_2": draw_demonstrations(groups, looks),
            **dict(draw_training_curves(results, groups)),
            "scores": draw_scores(groups, looks),
            "profiles": draw_profiles(groups, looks),
        }
    return {name: figure for name, figure in drawn.items() if figure is not None}


def number_given(group: Group) -> int:
    """Return the number of demonstrations, 0 if there are none."""
    return group.num_trajectories or 0


def split(groups: Iterable[Group], name: str) -> dict[str, list[Group]]:
    """Return the groups by their ``series`` or ``env_id``, in the order of ``groups``."""
    found: dict[str, list[Group]] = {}
    for group in groups:
        found.setdefault(getattr(group, name), []).append(group)
    return found


def most_demonstrated(
    groups: Iterable[Group], of_cells: Mapping[str, T]
) -> list[tuple[Group, list[T]]]:
    """Return, for each task and series, the group with the most demonstrations.

    Beside it are the values ``of_cells`` in the order of seeds. Groups without any do not count.
    """
    chosen = {}
    for group in sorted(groups, key=number_given):
        cells = sorted(group.cells, key=lambda cell: cell.seed)
        if values := [of_cells[cell.cell] for cell in cells if cell.cell in of_cells]:
            chosen[group.env_id, group.series] = group, values
    return list(chosen.values())


def looks_of(groups: Iterable[Group]) -> Looks:
    """Return the look of each series."""
    cycles = zip(split(groups, "series"), *map(itertools.cycle, (COLORS, MARKERS, LINES)))
    return {
        name: {"color": color, "marker": marker, "linestyle": line}
        for name, color, marker, line in cycles
    }


def draw_demonstrations(groups: Sequence[Group], looks: Looks) -> Figure | None:
    """Draw the paper's Figure 2: return of the kept policy against the number of demonstrations.

    Marks are the mean and standard deviation over seeds; each small dot is one seed.
    """
    groups = [group for group in groups if group.num_trajectories is not None]
    numbers = sorted({group.num_trajectories for group in groups if group.num_trajectories})
    if len(numbers) < 2:
        return None
    series = list(split(groups, "series"))
    figure, tasks = _task_panels(groups)
    apart = min(0.12 * np.diff(numbers).min(), 0.03 * np.ptp(numbers))
    beside = apart * (len(series) / 2 + 1)
    for axes, mine in tasks:
        draw_levels(axes, mine)
        by_series = split(sorted(mine, key=number_given), "series")
        for index, name in enumerate(series):
            if name not in by_series:
                continue
            shift = apart * (index - (len(series) - 1) / 2)
            at = np.array([number_given(group) + shift for group in by_series[name]])
            returns = [group.values("return_mean") for group in by_series[name]]
            means, stds = np.array(list(map(mean_std, returns))).T
            axes.errorbar(at, means, stds, label=legend_label(name), **looks[name])
            for x, each in zip(at, returns):
                dots = {"color": looks[name]["color"], "alpha": 0.45, "markersize": 3}
                axes.plot([x] * len(each), each, ".", **dots)
        limits = numbers[0] - beside, numbers[-1] + beside
        axes.set(xlabel="demonstrations", ylabel="return", xticks=numbers, xlim=limits)
    add_legend(figure)
    return figure


def draw_training_curves(
    results: SweepResults, groups: Sequence[Group]
) -> Iterator[tuple[str, Figure]]:
    """Draw the paper's Figure 3 for each series: means over the first 1, 3 and 5 seeds.

    Curves are those with the most demonstrations. Thin lines are raw, thick lines smoothed by a
    Gaussian filter. No seed is left out.
    """
    by_series = split(groups, "series")
    for (name, mine), slug in zip(by_series.items(), _slugs(by_series)):
        chosen = most_demonstrated(mine, results.curves)
        if not chosen:
            continue
        figure, tasks = _task_panels(group for group, _ in chosen)
        for (axes, _), (group, curves) in zip(tasks, chosen):
            if group.has_comparable_curves:
                draw_levels(axes, [group])
            numbers = [number for number in NUMBERS_OF_SEEDS if number <= len(curves)]
            for number, color, line in zip(numbers, COLORS, LINES):
                curve, label = mean_curve(curves[:number]), f"{number} seed{'s' * (number > 1)}"
                axes.plot(curve.iterations, curve.returns, color=color, linewidth=0.6, alpha=0.5)
                thick: Any = {"color": color, "linestyle": line, "linewidth": 1.6, "label": label}
                axes.plot(curve.iterations, smoothed(curve.returns), **thick)
            n = group.num_trajectories
            given = f" ({n} demonstration{'s' * (n != 1)})" if n else ""
            axes.set(xlabel=f"iteration{given}", ylabel="return")
        add_legend(figure, title=f"{name} · thin raw, thick smoothed")
        yield f"figure_3_{slug}", figure


def draw_scores(groups: Sequence[Group], looks: Looks) -> Figure | None:
    """Draw interquartile means of normalised returns with 95 % intervals, by task and overall.

    Filled marks are the kept policy, open marks the mean over training. Each small dot is the kept
    policy of one run.
    """
    groups = [group for group in groups if scores([group])]
    if not groups:
        return None
    series, columns = list(split(groups, "series")), split(groups, "env_id")
    common = comparable(groups)
    shared = [group for mine in common.values() for group in mine]
    number = len(split(shared, "env_id"))
    if number > 1 and all(common.values()):
        columns["all tasks" if number == len(columns) else f"{number} common tasks"] = shared
    names = [textwrap.fill(name, 24) for name in series]
    row_height = max(0.34, *(0.15 * (name.count("\n") + 1) for name in names))
    figure = Figure((WIDTH, 0.9 + row_height * len(names)), layout="constrained")
    all_axes = figure.subplots(1, len(columns), sharey=True, squeeze=False)[0]
    for axes, (title, column) in zip(all_axes, columns.items(), strict=True):
        axes.axvline(0, **RANDOM)
        axes.axvline(1, **EXPERT)
        for row, name in enumerate(series):
            mine = [group for group in column if group.series == name]
            color, marker = looks[name]["color"], looks[name]["marker"]
            for measure, shift, face in zip(MEASURES, (-0.06, 0.2), (color, "white")):
                if strata := scores(mine, measure):
                    iqm = interquartile_mean(strata)
                    # Rounding can put the ends for equal scores on the wrong side of the mean.
                    reach = np.maximum([[iqm.value - iqm.low], [iqm.high - iqm.value]], 0)
                    look = {"color": color, "marker": marker, "markerfacecolor": face}
                    axes.errorbar([iqm.value], [row + shift], xerr=reach, markersize=3.5, **look)
            runs = np.concatenate([[], *scores(mine)])
            axes.plot(runs, [row - 0.27] * len(runs), ".", color="0.5", markersize=2)
        axes.set_title(title, fontsize=8.5 if len(columns) <= 5 else 7)
        axes.locator_params(axis="x", nbins=3)
    all_axes[0].set_yticks(range(len(names)), names)
    all_axes[0].set_ylim(len(series) - 0.5, -0.5)
    explanation = "filled the kept policy, open the mean over training"
    figure.supxlabel(f"normalised return (0 random, 1 expert): {explanation}", fontsize=8)
    return figure


def draw_profiles(groups: Sequence[Group], looks: Looks) -> Figure | None:
    """Draw performance profiles: the share of runs above each normalised return, with 95 % bands.

    They compare series only under the conditions in which all of them were measured.
    """
    common = comparable(groups)
    figure = Figure((WIDTH, 2.5), layout="constrained")
    all_axes = figure.subplots(1, len(MEASURES), sharey=True)
    for axes, (measure, title) in zip(all_axes, MEASURES.items(), strict=True):
        for name, mine in common.items():
            if strata := scores(mine, measure):
                profile = performance_profile(strata)
                color, line = looks[name]["color"], looks[name]["linestyle"]
                band = {"color": color, "alpha": 0.18, "linewidth": 0, "step": "post"}
                axes.fill_between(THRESHOLDS, profile.low, profile.high, **band)
                look = {"color": color, "linestyle": line, "label": legend_label(name)}
                axes.step(THRESHOLDS, profile.value, where="post", **look)
        axes.set(title=title, xlabel="normalised return τ", ylim=(0, 1.02))
    all_axes[0].set_ylabel("share of runs above τ")
    if not any(axes.lines for axes in all_axes):
        return None
    add_legend(figure)
    return figure


def draw_levels(axes: Axes, groups: Sequence[Group]) -> None:
    """Draw lines at the returns of random actions and of each source of demonstrations."""
    experts: dict[str, dict[int, float]] = {}  # mean return by source and number
    for group in groups:
        levels = experts.setdefault(group.cells[0].demonstrations, {})
        levels[number_given(group)] = float(group.values("expert_return").mean())
    for levels in experts.values():
        numbers, returns = zip(*sorted(levels.items()))
        if len(numbers) > 1:
            axes.plot(numbers, returns, label="expert", **EXPERT)
        elif np.isfinite(returns[0]):
            axes.axhline(returns[0], label="expert", **EXPERT)
    random = np.mean([group.values("random_return").mean() for group in groups])
    axes.axhline(random, label="random", **RANDOM)


def _task_panels(groups: Iterable[Group]) -> tuple[Figure, list[tuple[Axes, list[Group]]]]:
    """Return a figure, and for each task its axes, with a title, and its groups."""
    tasks = split(groups, "env_id")
    figure, axes_of = panels(list(tasks), most_columns=2 if len(tasks) <= 4 else 3, row_height=2.0)
    for task, axes in axes_of.items():
        axes.set(title=task)
    return figure, list(zip(axes_of.values(), tasks.values()))


def _slugs(names: Iterable[str]) -> list[str]:
    """Return a different part of a file name for each series."""
    slugs: list[str] = []
    for name in names:
        plain = slug = re.sub(r"\W+", "_", name.lower()).strip("_")[:LONGEST_SLUG]
        numbers = itertools.count(2)
        while slug in slugs:
            slug = f"{plain}_{next(numbers)}"
        slugs.append(slug)
    return slugs
