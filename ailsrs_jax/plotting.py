"""The training curve of a run."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from ailsrs_jax.data.files import write_atomically
from ailsrs_jax.runs.tracking import read_rows

PANELS = {
    "evaluation_return": "return (not used)",
    "expert_distance": "energy distance to expert",
    "policy_score": "discriminator's score",
}


def plot_training_curve(
    run_directory: Path, title: str, expert_return: float, kept_iterations: Mapping[int, int]
) -> Path:
    """Draw ``training_curve.png`` from ``metrics.csv``; a dot marks each seed's kept policy."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    header, *rows = read_rows(run_directory / "metrics.csv")
    table = np.array(rows, float)
    columns = dict(zip(header, table.T, strict=True))
    figure, axes = plt.subplots(1, len(PANELS), figsize=(12, 3.4), layout="constrained")
    for axis, (name, label) in zip(axes, PANELS.items(), strict=True):
        for seed, kept in kept_iterations.items():
            mine = columns["seed"] == seed
            steps, values = columns["env_steps"][mine] / 1e6, columns[name][mine]
            (line,) = axis.plot(steps, values, linewidth=1.4, label=f"seed {seed}")
            at = columns["iteration"][mine] == kept
            axis.plot(steps[at], values[at], "o", color=line.get_color(), markersize=7)
        axis.set(xlabel="live environment steps [M]", ylabel=label)
        axis.spines[["top", "right"]].set_visible(False)
    axes[0].axhline(expert_return, color="black", linestyle="--", linewidth=1, label="expert")
    axes[0].legend(frameon=False, fontsize=8)
    axes[1].set_ylim(bottom=0)
    axes[2].set_ylim(0, 1)
    figure.suptitle(title)
    path = run_directory / "training_curve.png"
    write_atomically(path, lambda file: figure.savefig(file, format="png", dpi=130))
    plt.close(figure)
    return path
