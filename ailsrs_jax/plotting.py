"""The training curve of a run."""

from pathlib import Path

from ailsrs_jax.data.files import write_atomically
from ailsrs_jax.runs.run import Result
from ailsrs_jax.runs.tracking import read_metrics

# What is drawn of what a run has measured, and the range of its axis.
PANELS = {
    "evaluation_return": ("return", None),
    "expert_distance": ("energy distance to expert", (0, None)),
    "policy_score": ("discriminator's score", (0, 1)),
    "validation_loss": ("validation loss", (0, None)),
}


def plot_training_curve(run_directory: Path, title: str, result: Result) -> Path:
    """Draw ``training_curve.png`` from ``metrics.csv``; a dot marks each seed's kept policy."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    columns = read_metrics(run_directory / "metrics.csv")
    imitates = result.expert_returns is not None
    panels = {name: panel for name, panel in PANELS.items() if name in columns}
    figure, all_axes = plt.subplots(
        1, len(panels), figsize=(4 * len(panels), 3.4), layout="constrained", squeeze=False
    )
    axes = all_axes[0]
    for axis, (name, (label, limits)) in zip(axes, panels.items(), strict=True):
        for seed, kept in result.kept_iterations.items():
            mine = columns["seed"] == seed
            steps, values = columns["env_steps"][mine] / 1e6, columns[name][mine]
            (line,) = axis.plot(steps, values, linewidth=1.4, label=f"seed {seed}")
            at = columns["iteration"][mine] == kept
            axis.plot(steps[at], values[at], "o", color=line.get_color(), markersize=7)
        unused = " (not used)" if imitates and name == "evaluation_return" else ""
        axis.set(xlabel="live environment steps [M]", ylabel=label + unused)
        axis.set_ylim(limits)
        axis.spines[["top", "right"]].set_visible(False)
    if result.expert_returns is not None:
        level = result.expert_returns.mean()
        axes[0].axhline(level, color="black", linestyle="--", linewidth=1, label="expert")
    axes[0].legend(frameon=False, fontsize=8)
    figure.suptitle(title)
    path = run_directory / "training_curve.png"
    write_atomically(path, lambda file: figure.savefig(file, format="png", dpi=130))
    plt.close(figure)
    return path
