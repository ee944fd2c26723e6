"""The training curves of runs."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import style
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ailsrs_jax.files import write_atomically
from ailsrs_jax.runs.storage.saved_run import SavedRun, read_run
from ailsrs_jax.show.style import COLORS, EXPERT, STYLE, encoded, panels

# The panels: a column of metrics.csv, the label of its axis and the limits of that axis.
PANELS = {
    "evaluation_return": ("return", None),
    "expert_distance": ("energy distance to expert", (0, None)),
    "policy_score": ("discriminator's score", (0, 1)),
    "validation_loss": ("validation loss", (0, None)),
}
STEPS = "live environment steps [M]"
EVEN = 0.5  # the score of a discriminator that cannot tell the policy from the expert
MOST_NAMED = 8  # seeds in the legend
DASHED = (0, (4, 1.5))
DOTTED: dict[str, Any] = {"color": "0.6", "linestyle": (0, (1, 2)), "linewidth": 1, "zorder": 1}
LARGER: list[Any] = [STYLE, {"font.size": 9}]


def plot_training_curve(directory: Path) -> Path:
    """Draw ``training_curve.png`` in a run directory; a dot marks the kept policy of each seed.

    Raises:
        UserError: the directory is not that of a run.
    """
    run = read_run(directory)
    figure = draw_curves(run)
    title = f"{run.title} on {run.config['env_id']}"
    if number := run.config["num_trajectories"]:
        title += f" from {number} demonstration{'s' * (number != 1)}"
    figure.suptitle(title)
    path = directory / "training_curve.png"
    write_atomically(path, encoded(figure, "png", dpi=130))
    return path


def draw_curves(run: SavedRun) -> Figure:
    """Draw a panel for each of :data:`PANELS` that the run has measured, with a line per seed."""
    columns = [name for name in PANELS if name in run.metrics]
    with style.context(LARGER):
        figure, all_axes = panels(columns, len(PANELS), row_height=2.9, width=4 * len(columns))
        for index, (seed, mine) in enumerate(by_seed(run).items()):
            color = COLORS[index % len(COLORS)]
            steps = mine["env_steps"] / 1e6
            at = mine["iteration"] == run.kept_iterations.get(seed)
            for name, axes in all_axes.items():
                named = f"seed {seed}" if index < MOST_NAMED and name == "evaluation_return" else ""
                axes.plot(steps, mine[name], color=color, label=named)
                axes.plot(steps[at], mine[name][at], "o", color=color, markersize=6)
                if name == "policy_score":
                    _draw_expert_score(axes, mine, color)
        for name, axes in all_axes.items():
            label, limits = PANELS[name]
            axes.set(xlabel=STEPS, ylabel=label)
            if limits is not None:
                axes.set(ylim=limits)
        _explain_returns(all_axes["evaluation_return"], run)
        if "policy_score" in all_axes:
            _explain_scores(all_axes["policy_score"])
    return figure


def by_seed(run: SavedRun) -> dict[int, dict[str, np.ndarray]]:
    """Return the metrics of each seed, in the order of the seeds in ``metrics.csv``."""
    seeds = dict.fromkeys(run.metrics["seed"].astype(int).tolist())
    return {seed: run.of_seed(seed) for seed in seeds}


def _draw_expert_score(axes: Axes, metrics: Mapping[str, np.ndarray], color: str) -> None:
    """Draw the expert's score, dashed, and shade the gap to the policy's."""
    if "expert_score" not in metrics:
        return
    steps, expert = metrics["env_steps"] / 1e6, metrics["expert_score"]
    axes.plot(steps, expert, color=color, linestyle=DASHED, linewidth=1.0)
    axes.fill_between(steps, metrics["policy_score"], expert, color=color, alpha=0.08, linewidth=0)


def _explain_returns(axes: Axes, run: SavedRun) -> None:
    """Add the expert's return and a legend; imitators do not train on the return."""
    if run.imitates:
        axes.set_ylabel("return (not used)")
    if (expert := run.expert_return) is not None:
        axes.axhline(expert, label="expert", **EXPERT)
    axes.legend()


def _explain_scores(axes: Axes) -> None:
    """Add a legend of the line styles; the colours are explained elsewhere."""
    lines = {"of the expert": DASHED, "of the policy": "-"}
    handles = [axes.plot([], [], color="black", linestyle=line)[0] for line in lines.values()]
    handles.append(axes.axhline(EVEN, **DOTTED))
    axes.legend(handles, [*lines, "cannot tell"])
