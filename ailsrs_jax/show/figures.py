"""The figures of a sweep, as PNG and PDF: drawn from its tables alone."""

import itertools
import re
import textwrap
from collections.abc import Iterable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ailsrs_jax.files import write_atomically
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
WIDTH = 7.16  # [in] of a page with two columns
STYLE: dict[Any, Any] = {
    "font.size": 8,
    "axes.labelsize": 8,
    "axes.titlesize": 8.5,
    "legend.fontsize": 8,
    "legend.frameon": False,
    "legend.handlelength": 2.8,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "lines.linewidth": 1.3,
    "lines.markersize": 4.5,
    "errorbar.capsize": 2,
    "text.parse_math": False,  # a dollar in a name is a dollar
    "pdf.fonttype": 42,  # editable, and what publishers ask for
    "savefig.dpi": 160,
}
# Okabe and Ito's colours, but for yellow and for black, which is the expert's. Each series has a
# marker and a line style of its own besides, so that it survives a photocopier.
COLORS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#7F7F7F")
MARKERS = ("o", "s", "^", "D", "v", "P", "X", "*")
LINES = ("-", (0, (5, 1.5)), (0, (3, 1, 1, 1)), (0, (1.5, 1)))
EXPERT: dict[str, Any] = {"color": "black", "linestyle": (0, (6, 3)), "linewidth": 0.9, "zorder": 1}
RANDOM: dict[str, Any] = {"color": "0.45", "linestyle": (0, (1, 2)), "linewidth": 1.1, "zorder": 1}
NUMBERS_OF_SEEDS = (1, 3, 5)  # of the paper's Figure 3


def draw_figures(results: SweepResults, directory: Path) -> None:
    """Write every figure that the results have something for."""
    groups = group_cells(results.cells)
    if not groups:
        return
    looks = _looks(groups)
    with matplotlib.rc_context(STYLE):
        draw_demonstrations(groups, looks, directory)
        draw_training_curves(results, groups, directory)
        draw_scores(groups, looks, directory)
        draw_profiles(groups, looks, directory)


Looks = dict[str, dict[str, Any]]  # by series: colour, marker, line style


def _looks(groups: Sequence[Group]) -> Looks:
    series = dict.fromkeys(group.series for group in groups)
    cycles = zip(series, *map(itertools.cycle, (COLORS, MARKERS, LINES)))
    return {
        name: {"color": color, "marker": marker, "linestyle": line}
        for name, color, marker, line in cycles
    }


def draw_demonstrations(groups: Sequence[Group], looks: Looks, directory: Path) -> None:
    """The paper's Figure 2: the kept policy's return against the number of demonstrations.

    Mean and standard deviation over seeds; a small dot is a seed.
    """
    groups = [group for group in groups if group.num_trajectories is not None]
    numbers = sorted({group.num_trajectories for group in groups if group.num_trajectories})
    if len(numbers) < 2:
        return
    series = [name for name in looks if any(group.series == name for group in groups)]
    tasks = list(dict.fromkeys(group.env_id for group in groups))
    figure, panels = _panels(tasks)
    apart = min(0.12 * np.diff(numbers).min(), 0.03 * np.ptp(numbers))
    for task, axes in panels.items():
        mine = [group for group in groups if group.env_id == task]
        _draw_levels(axes, mine)
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
                color = looks[name]["color"]
                axes.plot([x] * len(returns), returns, ".", color=color, alpha=0.45, markersize=3)
        axes.set(title=task, xlabel="demonstrations", ylabel="return", xticks=numbers)
    _add_legend(figure, panels.values())
    _save(figure, directory / "figure_2")


def draw_training_curves(results: SweepResults, groups: Sequence[Group], directory: Path) -> None:
    """The paper's Figure 3, of each series: training curves, the means of 1, 3 and 5 seeds.

    With the most demonstrations there are. Thin lines are raw, thick ones smoothed by a Gaussian
    filter. Seeds are taken in their order; none is left out.
    """
    slugs = _slugs(dict.fromkeys(group.series for group in groups))
    for name in slugs:
        chosen: dict[str, Group] = {}
        for group in sorted(
            (group for group in groups if group.series == name),
            key=lambda group: group.num_trajectories or 0,
        ):
            if any(cell.cell in results.curves for cell in group.cells):
                chosen[group.env_id] = group
        if not chosen:
            continue
        figure, panels = _panels(list(chosen))
        for task, axes in panels.items():
            cells = sorted(chosen[task].cells, key=lambda cell: cell.seed)
            curves = [results.curves[cell.cell] for cell in cells if cell.cell in results.curves]
            if chosen[task].has_comparable_curves:
                _draw_levels(axes, [chosen[task]])
            for index, number in enumerate(NUMBERS_OF_SEEDS):
                if number > len(curves):
                    continue
                curve = mean_curve(curves[:number])
                color = COLORS[index]
                axes.plot(curve.iterations, curve.returns, color=color, linewidth=0.6, alpha=0.5)
                axes.plot(
                    curve.iterations,
                    smoothed(curve.returns),
                    color=color,
                    linestyle=LINES[index],
                    linewidth=1.6,
                    label=f"{number} seed{'s' * (number > 1)}",
                )
            trajectories = chosen[task].num_trajectories
            given = f" ({trajectories} demonstrations)" if trajectories else ""
            axes.set(title=task, xlabel=f"iteration{given}", ylabel="return")
        _add_legend(figure, panels.values(), title=f"{name} · thin raw, thick smoothed")
        _save(figure, directory / f"figure_3_{slugs[name]}")


def draw_scores(groups: Sequence[Group], looks: Looks, directory: Path) -> None:
    """Interquartile means of the normalised scores and their 95 % intervals, by task and overall.

    Filled: the kept policy, with a small dot above for each run; open: the mean over training.
    """
    groups = [group for group in groups if scores([group])]
    if not groups:
        return
    looks = {name: looks[name] for name in dict.fromkeys(group.series for group in groups)}
    tasks = list(dict.fromkeys(group.env_id for group in groups))
    columns: dict[str, list[Group]] = {
        task: [group for group in groups if group.env_id == task] for task in tasks
    }
    common = comparable(groups)
    shared = [group for mine in common.values() for group in mine]
    num_shared = len({group.env_id for group in shared})
    if num_shared > 1 and all(common.values()):
        name = "all tasks" if num_shared == len(tasks) else f"{num_shared} common tasks"
        columns[name] = shared
    names = [textwrap.fill(name, 24) for name in looks]
    row_height = max(0.34, *(0.15 * (name.count("\n") + 1) for name in names))
    figure = Figure((WIDTH, 0.9 + row_height * len(names)), layout="constrained")
    all_axes = figure.subplots(1, len(columns), sharey=True, squeeze=False)[0]
    for axes, (title, mine) in zip(all_axes, columns.items(), strict=True):
        axes.axvline(0, **RANDOM)
        axes.axvline(1, **EXPERT)
        for row, (name, look) in enumerate(looks.items()):
            series = [group for group in mine if group.series == name]
            for measure, shift, fill in (
                ("normalized", -0.06, look["color"]),
                ("normalized_over_training", 0.2, "white"),
            ):
                strata = scores(series, measure)
                if not strata:
                    continue
                iqm = interquartile_mean(strata)
                # Of equal scores the ends may be on the wrong side, by a rounding.
                reach = np.maximum([[iqm.value - iqm.low], [iqm.high - iqm.value]], 0)
                axes.errorbar(
                    [iqm.value],
                    [row + shift],
                    xerr=reach,
                    color=look["color"],
                    marker=look["marker"],
                    markerfacecolor=fill,
                    markersize=3.5,
                )
                if measure == "normalized":
                    runs = np.concatenate(strata)
                    axes.plot(runs, [row - 0.27] * len(runs), ".", color="0.5", markersize=2)
        axes.set_title(title, fontsize=8.5 if len(columns) <= 5 else 7)
        axes.locator_params(axis="x", nbins=3)
    all_axes[0].set_yticks(range(len(names)), names)
    all_axes[0].set_ylim(len(looks) - 0.5, -0.5)
    figure.supxlabel(
        "normalised return (0 random, 1 expert): filled the kept policy, open the mean over "
        "training",
        fontsize=8,
    )
    _save(figure, directory / "scores")


def draw_profiles(groups: Sequence[Group], looks: Looks, directory: Path) -> None:
    """Performance profiles: the share of runs above each normalised score, with 95 % bands.

    Only under the conditions that all series have been measured under.
    """
    common = comparable(groups)
    titles = {"normalized": "kept policy", "normalized_over_training": "mean over training"}
    figure = Figure((WIDTH, 2.5), layout="constrained")
    panels = figure.subplots(1, len(titles), sharey=True)
    drawn = False
    for axes, (measure, title) in zip(panels, titles.items(), strict=True):
        for name, mine in common.items():
            strata = scores(mine, measure)
            if not strata:
                continue
            drawn = True
            profile = performance_profile(strata)
            color, line = looks[name]["color"], looks[name]["linestyle"]
            band = {"color": color, "alpha": 0.18, "linewidth": 0, "step": "post"}
            axes.fill_between(THRESHOLDS, profile.low, profile.high, **band)
            look = {"color": color, "linestyle": line, "label": name}
            axes.step(THRESHOLDS, profile.value, where="post", **look)
        axes.set(title=title, xlabel="normalised return τ", ylim=(0, 1.02))
    panels[0].set_ylabel("share of runs above τ")
    if drawn:
        _add_legend(figure, panels)
        _save(figure, directory / "profiles")


def _panels(titles: Sequence[str]) -> tuple[Figure, dict[str, Axes]]:
    """A figure with axes for each title."""
    num_columns = min(len(titles), 2 if len(titles) <= 4 else 3)
    num_rows = -(-len(titles) // num_columns)
    figure = Figure((WIDTH, 0.5 + 2.0 * num_rows), layout="constrained")
    axes = figure.subplots(num_rows, num_columns, squeeze=False).flat
    for unused in axes[len(titles) :]:
        unused.remove()
    return figure, dict(zip(titles, axes))


def _draw_levels(axes: Axes, groups: Sequence[Group]) -> None:
    """Lines at the returns of random actions, and of the experts if there are any."""
    experts: dict[str, dict[int, float]] = {}  # by their demonstrations, and the number of them
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


def _add_legend(figure: Figure, panels: Any, title: str | None = None) -> None:
    """One legend above all panels."""
    handles: dict[str, Any] = {}
    for axes in panels:
        for handle, label in zip(*axes.get_legend_handles_labels()):
            handles.setdefault(label, handle)
    longest = 0.7 + 0.065 * max(map(len, handles))  # [in] a column, with its line
    num_columns = min(max(int(WIDTH / longest), 1), len(handles))
    num_rows = -(-len(handles) // num_columns)
    figure.set_figheight(figure.get_figheight() + 0.17 * (num_rows - 1))
    figure.legend(
        list(handles.values()),
        list(handles),
        loc="outside upper center",
        ncols=num_columns,
        title=title,
    )


def _slugs(names: Iterable[str]) -> dict[str, str]:
    """Each name as a part of a file's: as it is, nearly, with a number where that is taken."""
    slugs: dict[str, str] = {}
    for name in names:
        plain = re.sub(r"\W+", "_", name.lower()).strip("_")[:LONGEST_SLUG]
        numbered = (f"{plain}_{number}" for number in itertools.count(2))
        taken = slugs.values()
        slugs[name] = next(slug for slug in itertools.chain([plain], numbered) if slug not in taken)
    return slugs


def _save(figure: Figure, path: Path) -> None:
    """Write ``path`` as PNG and PDF: the same bytes whenever they are drawn from the same data."""
    metadata: dict[str, dict[str, Any]] = {"png": {}, "pdf": {"CreationDate": None}}
    for kind, facts in metadata.items():
        write = partial(figure.savefig, format=kind, metadata=facts)
        write_atomically(path.with_suffix(f".{kind}"), write)
