"""The training curves of runs."""

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import style
from matplotlib.figure import Figure

from ailsrs_jax.files import write_atomically
from ailsrs_jax.runs.storage.saved_run import SavedRun, read_run
from ailsrs_jax.show.style import COLORS, EXPERT, STYLE, encoded, panels

# The panels: a column of metrics.csv, the label of its axis and the limits of that axis.
PANELS: dict[str, tuple[str, tuple[float | None, float | None]]] = {
    "evaluation_return": ("return", (None, None)),
    "expert_distance": ("energy distance to expert", (0, None)),
    "policy_score": ("discriminator's score", (0, 1)),
    "validation_loss": ("validation loss", (0, None)),
}
STEPS = "live environment steps [M]"
EVEN = 0.5  # the score of a discriminator that cannot tell the policy from the expert
MOST_NAMED = 8  # seeds in the legend
DASHED = (0, (4, 1.5))
DOTTED: dict[str, Any] = {"color": "0.6", "linestyle": (0, (1, 2)), "linewidth": 1, "zorder": 1}
GAP: dict[str, Any] = {"alpha": 0.08, "linewidth": 0}  # between expert and policy
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
        for name, axes in all_axes.items():
            for index, (seed, mine) in enumerate(by_seed(run).items()):
                color, steps = COLORS[index % len(COLORS)], mine["env_steps"] / 1e6
                at = mine["iteration"] == run.kept_iterations.get(seed)
                named = f"seed {seed}" if index < MOST_NAMED else ""
                axes.plot(steps, mine[name], color=color, label=named)
                axes.plot(steps[at], mine[name][at], "o", color=color, markersize=6)
                if name == "policy_score" and "expert_score" in mine:
                    expert = mine["expert_score"]
                    axes.plot(steps, expert, color=color, linestyle=DASHED, linewidth=1.0)
                    axes.fill_between(steps, mine[name], expert, **GAP, color=color)
            label, limits = PANELS[name]
            if name == "evaluation_return":
                if run.imitates:  # not trained on
                    label = "return (not used)"
                if run.comparable_expert_return is not None:
                    axes.axhline(run.comparable_expert_return, label="expert", **EXPERT)
                axes.legend()
            elif name == "policy_score":
                lines = {"of the expert": DASHED, "of the policy": "-"}
                handles = [
                    axes.plot([], [], color="black", linestyle=line)[0] for line in lines.values()
                ]
                handles.append(axes.axhline(EVEN, **DOTTED))
                axes.legend(handles, [*lines, "cannot tell"])
            axes.set(xlabel=STEPS, ylabel=label, ylim=limits)
    return figure


def by_seed(run: SavedRun) -> dict[int, dict[str, np.ndarray]]:
    """Return the metrics of each seed, in the order of the seeds in ``metrics.csv``."""
    seeds = dict.fromkeys(run.metrics["seed"].astype(int).tolist())
    return {seed: run.of_seed(seed) for seed in seeds}
