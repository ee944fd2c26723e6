"""The training curves of runs."""

import itertools
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from ailsrs_jax.files import write_atomically
from ailsrs_jax.runs.loop import Result
from ailsrs_jax.runs.storage.metrics import read_metrics
from ailsrs_jax.runs.storage.saved_run import SavedRun
from ailsrs_jax.show.figures import COLORS, EXPERT, STYLE

# What is drawn of what a run has measured, and the range of its axis.
PANELS = {
    "evaluation_return": ("return", None),
    "expert_distance": ("energy distance to expert", (0, None)),
    "policy_score": ("discriminator's score", (0, 1)),
    "validation_loss": ("validation loss", (0, None)),
}
EVEN = 0.5  # the score of a discriminator that cannot tell the policy from the expert
MOST_NAMED = 8  # seeds, in the legend
DASHED = (0, (4, 1.5))


def plot_training_curve(run_directory: Path, title: str, result: Result) -> Path:
    """Draw ``training_curve.png`` from ``metrics.csv``; a dot marks each seed's kept policy."""
    columns = read_metrics(run_directory / "metrics.csv")
    expert_returns = result.expert_returns
    figure = draw_curves(
        columns,
        result.kept_iterations,
        None if expert_returns is None else float(expert_returns.mean()),
        imitates=expert_returns is not None,
    )
    figure.suptitle(title)
    path = run_directory / "training_curve.png"
    write_atomically(path, lambda file: figure.savefig(file, format="png", dpi=130))
    return path


def draw_curves(
    columns: Mapping[str, np.ndarray],
    kept_iterations: Mapping[int, int],
    expert_return: float | None,
    *,
    imitates: bool,
) -> Figure:
    """A panel for each of :data:`PANELS` that is in ``columns``, of all seeds.

    In the discriminator's the policy's score is drawn through, the expert's dashed: a game that is
    even has both near one half, and a discriminator that wins outright pulls them apart, to 0 and
    1, and has nothing to teach any more.
    """
    panels = {name: panel for name, panel in PANELS.items() if name in columns}
    style: dict[Any, Any] = STYLE | {"font.size": 9, "legend.fontsize": 8}
    with matplotlib.rc_context(style):
        figure = Figure((4 * len(panels), 3.4), layout="constrained")
        all_axes = figure.subplots(1, len(panels), squeeze=False)[0]
        for axes, (name, (label, limits)) in zip(all_axes, panels.items()):
            for index, seed in enumerate(dict.fromkeys(columns["seed"].astype(int).tolist())):
                color = COLORS[index % len(COLORS)]
                mine = columns["seed"] == seed
                steps = columns["env_steps"][mine] / 1e6
                at = columns["iteration"][mine] == kept_iterations.get(seed)
                values = columns[name][mine]
                named = f"seed {seed}" if index < MOST_NAMED and name == "evaluation_return" else ""
                axes.plot(steps, values, color=color, label=named)
                axes.plot(steps[at], values[at], "o", color=color, markersize=6)
                if name == "policy_score":
                    _draw_expert_score(axes, columns, mine, color)
            unused_note = " (not used)" if imitates and name == "evaluation_return" else ""
            axes.set(xlabel="live environment steps [M]", ylabel=label + unused_note)
            if limits is not None:
                axes.set_ylim(limits)
            if name == "policy_score":
                _explain_scores(axes)
            elif name == "evaluation_return":
                if expert_return is not None:
                    axes.axhline(expert_return, label="expert", **EXPERT)
                axes.legend()
    return figure


def draw_discriminators(tasks: Mapping[str, Sequence[tuple[str, SavedRun]]]) -> Figure:
    """The discriminator's scores in each of the runs, by task, with the name of its series.

    As in :func:`draw_curves`, but that a colour is a series.
    """
    series = dict.fromkeys(name for runs in tasks.values() for name, _ in runs)
    colors = dict(zip(series, itertools.cycle(COLORS)))
    num_columns = min(len(tasks), 3)
    num_rows = -(-len(tasks) // num_columns)
    style: dict[Any, Any] = STYLE | {"font.size": 9}
    with matplotlib.rc_context(style):
        figure = Figure((4 * num_columns, 0.4 + 3 * num_rows), layout="constrained")
        all_axes = figure.subplots(num_rows, num_columns, squeeze=False).flat
        for unused in all_axes[len(tasks) :]:
            unused.remove()
        for axes, (task, runs) in zip(all_axes, tasks.items()):
            for name, run in runs:
                columns, everything = run.metrics, np.ones(len(run.metrics["seed"]), bool)
                steps = columns["env_steps"] / 1e6
                axes.plot(steps, columns["policy_score"], color=colors[name])
                _draw_expert_score(axes, columns, everything, colors[name])
            axes.set(title=task, xlabel="live environment steps [M]", ylim=(0, 1))
            _explain_scores(axes)
        if len(series) > 1:
            lines = [Line2D([], [], color=color) for color in colors.values()]
            figure.legend(lines, list(series), loc="outside upper center", ncols=4)
    return figure


def _draw_expert_score(
    axes: Axes, columns: Mapping[str, np.ndarray], rows: np.ndarray, color: str
) -> None:
    """The expert's score, dashed, and how far the policy's is away."""
    if "expert_score" not in columns:
        return
    steps = columns["env_steps"][rows] / 1e6
    expert, policy = (columns[name][rows] for name in ("expert_score", "policy_score"))
    axes.plot(steps, expert, color=color, linestyle=DASHED, linewidth=1.0)
    axes.fill_between(steps, policy, expert, color=color, alpha=0.08, linewidth=0)


def _explain_scores(axes: Axes) -> None:
    """What line is whose; without a word on seeds, whose colours the first panel explains."""
    axes.axhline(EVEN, color="0.6", linestyle=(0, (1, 2)), linewidth=1, zorder=1)
    axes.plot([], [], color="black", linestyle=DASHED, linewidth=1.0, label="of the expert")
    axes.plot([], [], color="black", label="of the policy")
    axes.plot([], [], color="0.6", linestyle=(0, (1, 2)), label="cannot tell")
    axes.legend()
