"""Draw the curves of docs/debugging.md: a healthy run, and one that the discriminator wins.

usage: python -m experiments.debugging    (writes docs/pictures/discriminator.png)

The curves come from experiments/debugging/, which has the settings and metrics of two runs at
commit 0fb3d7d:

    ailsrs train hopper --num-trajectories 10 --output even
    ailsrs train hopper --num-trajectories 10 --output lost --iterations 30
        --set gradient_penalty=0 memory_iterations=1 discriminator_steps=50
        behavior_cloning_start=false

Each run has one seed. The picture is an illustration, not a comparison.
"""

from pathlib import Path

import matplotlib as mpl

from ailsrs_jax.runs.storage.metrics import read_metrics

mpl.use("Agg")
import matplotlib.pyplot as plt

RUNS = Path(__file__).parent / "debugging"
PICTURE = Path(__file__).parent.parent / "docs" / "pictures" / "discriminator.png"
# For each panel: the label, the value of pure guessing, and the columns of metrics.csv.
PANELS = (
    ("score D", 0.5, {"expert_score": "expert's steps", "policy_score": "policy's steps"}),
    ("imitation reward", 0.693, {"imitation_reward": None}),
    ("energy distance to expert", None, {"expert_distance": None}),
    ("episode length", None, {"evaluation_length": None}),
)


def main() -> None:
    """Draw both runs, one above the other."""
    figure, rows = plt.subplots(2, len(PANELS), figsize=(11, 4.6), layout="constrained")
    for axes, name in zip(rows, ("even", "lost"), strict=True):
        metrics = read_metrics(RUNS / name / "metrics.csv")
        for axis, (label, chance, columns) in zip(axes, PANELS, strict=True):
            for column, legend in columns.items():
                axis.plot(metrics["iteration"], metrics[column], label=legend)
            if chance is not None:
                axis.axhline(chance, color="black", linestyle=":", linewidth=1)
            axis.set(title=label if name == "even" else None, ylim=(0, None))
            axis.spines[["top", "right"]].set_visible(False)
        axes[0].set(ylabel=name, ylim=(0, 1))
    for axis in rows[1]:
        axis.set_xlabel("iteration")
    rows[1, 0].legend(frameon=False, fontsize=8, loc="center")
    figure.savefig(PICTURE, dpi=110, metadata={"Software": None})


if __name__ == "__main__":
    main()
