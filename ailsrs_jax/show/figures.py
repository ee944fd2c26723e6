"""The figures of a sweep, drawn from its tables alone."""

import itertools
import re
import textwrap
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

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


def looks_of(groups: Iterable[Group]) -> Looks:
    """Return the look of each series."""
    series = dict.fromkeys(group.series for group in groups)
    cycles = zip(series, *map(itertools.cycle, (COLORS, MARKERS, LINES)))
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
    series = [name for name in looks if any(group.series == name for group in groups)]
    figure, axes_of = _task_panels(groups)
    apart = min(0.12 * np.diff(numbers).min(), 0.03 * np.ptp(numbers))
    for task, axes in axes_of.items():
        mine = [group for group in groups if group.env_id == task]
        draw_levels(axes, mine)
        for index, name in enumerate(series):
            shift = apart * (index - (len(series) - 1) / 2)
            points = sorted(
                (group.num_trajectories or 0, group.values("return_mean"))
                for group in mine
                if group.series == name
            )
            if not points:
                continue
            at = np.array([number for number, _ in points]) + shift
            means, stds = np.array([mean_std(returns) for _, returns in points]).T
            axes.errorbar(at, means, stds, label=name, **looks[name])
            for x, (_, returns) in zip(at, points):
                dots = {"color": looks[name]["color"], "alpha": 0.45, "markersize": 3}
                axes.plot([x] * len(returns), returns, ".", **dots)
        axes.set(title=task, xlabel="demonstrations", ylabel="return", xticks=numbers)
    add_legend(figure, axes_of.values())
    return figure


def draw_training_curves(
    results: SweepResults, groups: Sequence[Group]
) -> Iterator[tuple[str, Figure]]:
    """Draw the paper's Figure 3 for each series: means over the first 1, 3 and 5 seeds.

    Curves are those with the most demonstrations. Thin lines are raw, thick lines smoothed by a
    Gaussian filter. No seed is left out.
    """
    for name, slug in _slugs(dict.fromkeys(group.series for group in groups)).items():
        chosen: dict[str, Group] = {}
        for group in sorted(groups, key=lambda group: group.num_trajectories or 0):
            if group.series == name and any(cell.cell in results.curves for cell in group.cells):
                chosen[group.env_id] = group
        if not chosen:
            continue
        figure, axes_of = _task_panels(chosen.values())
        for task, axes in axes_of.items():
            group = chosen[task]
            cells = sorted(group.cells, key=lambda cell: cell.seed)
            curves = [results.curves[cell.cell] for cell in cells if cell.cell in results.curves]
            if group.has_comparable_curves:
                draw_levels(axes, [group])
            for number, color, line in zip(NUMBERS_OF_SEEDS, COLORS, LINES):
                if number > len(curves):
                    continue
                curve = mean_curve(curves[:number])
                axes.plot(curve.iterations, curve.returns, color=color, linewidth=0.6, alpha=0.5)
                (thick,) = axes.plot(curve.iterations, smoothed(curve.returns), color=color)
                label = f"{number} seed{'s' * (number > 1)}"
                thick.set(linestyle=line, linewidth=1.6, label=label)
            n = group.num_trajectories
            given = f" ({n} demonstration{'s' * (n != 1)})" if n else ""
            axes.set(title=task, xlabel=f"iteration{given}", ylabel="return")
        add_legend(figure, axes_of.values(), title=f"{name} · thin raw, thick smoothed")
        yield f"figure_3_{slug}", figure


def draw_scores(groups: Sequence[Group], looks: Looks) -> Figure | None:
    """Draw interquartile means of normalised returns with 95 % intervals, by task and overall.

    Filled marks are the kept policy, open marks the mean over training. Each small dot is the kept
    policy of one run.
    """
    groups = [group for group in groups if scores([group])]
    if not groups:
        return None
    series = list(dict.fromkeys(group.series for group in groups))
    columns = _score_columns(groups)
    names = [textwrap.fill(name, 24) for name in series]
    row_height = max(0.34, *(0.15 * (name.count("\n") + 1) for name in names))
    figure = Figure((WIDTH, 0.9 + row_height * len(names)), layout="constrained")
    all_axes = figure.subplots(1, len(columns), sharey=True, squeeze=False)[0]
    for axes, (title, column) in zip(all_axes, columns.items(), strict=True):
        axes.axvline(0, **RANDOM)
        axes.axvline(1, **EXPERT)
        for row, name in enumerate(series):
            mine = [group for group in column if group.series == name]
            _draw_interval(axes, row - 0.06, scores(mine), looks[name], filled=True)
            over_training = scores(mine, "normalized_over_training")
            _draw_interval(axes, row + 0.2, over_training, looks[name], filled=False)
            runs = np.concatenate([[], *scores(mine)])
            axes.plot(runs, [row - 0.27] * len(runs), ".", color="0.5", markersize=2)
        axes.set_title(title, fontsize=8.5 if len(columns) <= 5 else 7)
        axes.locator_params(axis="x", nbins=3)
    all_axes[0].set_yticks(range(len(names)), names)
    all_axes[0].set_ylim(len(series) - 0.5, -0.5)
    explanation = "filled the kept policy, open the mean over training"
    figure.supxlabel(f"normalised return (0 random, 1 expert): {explanation}", fontsize=8)
    return figure


def _score_columns(groups: Sequence[Group]) -> dict[str, Sequence[Group]]:
    """Return the groups of each task, and all that can be compared over several tasks."""
    tasks = list(dict.fromkeys(group.env_id for group in groups))
    columns: dict[str, Sequence[Group]] = {
        task: [group for group in groups if group.env_id == task] for task in tasks
    }
    common = comparable(groups)
    shared = [group for mine in common.values() for group in mine]
    number = len({group.env_id for group in shared})
    if number > 1 and all(common.values()):
        columns["all tasks" if number == len(tasks) else f"{number} common tasks"] = shared
    return columns


def _draw_interval(
    axes: Axes, y: float, strata: list[np.ndarray], look: Mapping[str, Any], *, filled: bool
) -> None:
    """Draw an interquartile mean and its interval at the height ``y``, if there are any scores."""
    if not strata:
        return
    iqm = interquartile_mean(strata)
    # Rounding can put the ends of an interval of equal scores on the wrong side of the mean.
    reach = np.maximum([[iqm.value - iqm.low], [iqm.high - iqm.value]], 0)
    marker = {"color": look["color"], "marker": look["marker"], "markersize": 3.5}
    face = look["color"] if filled else "white"
    axes.errorbar([iqm.value], [y], xerr=reach, markerfacecolor=face, **marker)


def draw_profiles(groups: Sequence[Group], looks: Looks) -> Figure | None:
    """Draw performance profiles: the share of runs above each normalised return, with 95 % bands.

    They compare series only under the conditions in which all of them were measured.
    """
    common = comparable(groups)
    titles = {"normalized": "kept policy", "normalized_over_training": "mean over training"}
    figure = Figure((WIDTH, 2.5), layout="constrained")
    all_axes = figure.subplots(1, len(titles), sharey=True)
    for axes, (measure, title) in zip(all_axes, titles.items(), strict=True):
        for name, mine in common.items():
            if strata := scores(mine, measure):
                profile = performance_profile(strata)
                color, line = looks[name]["color"], looks[name]["linestyle"]
                band = {"color": color, "alpha": 0.18, "linewidth": 0, "step": "post"}
                axes.fill_between(THRESHOLDS, profile.low, profile.high, **band)
                look = {"color": color, "linestyle": line, "label": name}
                axes.step(THRESHOLDS, profile.value, where="post", **look)
        axes.set(title=title, xlabel="normalised return τ", ylim=(0, 1.02))
    all_axes[0].set_ylabel("share of runs above τ")
    if not any(axes.lines for axes in all_axes):
        return None
    add_legend(figure, all_axes)
    return figure


def draw_levels(axes: Axes, groups: Sequence[Group]) -> None:
    """Draw lines at the returns of random actions and of each source of demonstrations."""
    experts: dict[str, dict[int, float]] = {}  # mean return by source and number
    for group in groups:
        levels = experts.setdefault(group.cells[0].demonstrations, {})
        levels[group.num_trajectories or 0] = float(group.values("expert_return").mean())
    for levels in experts.values():
        numbers, returns = zip(*sorted(levels.items()))
        if len(numbers) > 1:
            axes.plot(numbers, returns, label="expert", **EXPERT)
        elif np.isfinite(returns[0]):
            axes.axhline(returns[0], label="expert", **EXPERT)
    random = np.mean([group.values("random_return").mean() for group in groups])
    axes.axhline(random, label="random", **RANDOM)


def _task_panels(groups: Iterable[Group]) -> tuple[Figure, dict[str, Axes]]:
    tasks = list(dict.fromkeys(group.env_id for group in groups))
    return panels(tasks, most_columns=2 if len(tasks) <= 4 else 3, row_height=2.0)


def _slugs(names: Iterable[str]) -> dict[str, str]:
    """Return a different part of a file name for each series."""
    slugs: dict[str, str] = {}
    for name in names:
        plain = slug = re.sub(r"\W+", "_", name.lower()).strip("_")[:LONGEST_SLUG]
        numbers = itertools.count(2)
        while slug in slugs.values():
            slug = f"{plain}_{next(numbers)}"
        slugs[name] = slug
    return slugs
