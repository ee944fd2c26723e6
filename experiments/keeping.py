"""How well the reward-free choice of the kept policy does, from the metrics of finished runs.

usage: python experiments/keeping.py RUN_DIRECTORY ...

Of each seed: the evaluation return (4 episodes) of the kept iterate, the one with the smallest
energy distance to the expert; of the last; and of the best, which only the reward could point out;
and Spearman's rank correlation of distance and return over the iterates.
"""

import sys
from pathlib import Path

import numpy as np
from scipy import stats

from ailsrs_jax.runs.tracking import read_rows


def main() -> None:
    """Print a row per run and seed."""
    for directory in map(Path, sys.argv[1:]):
        header, *rows = read_rows(directory / "metrics.csv")
        columns = dict(zip(header, np.array(rows, float).T, strict=True))
        for seed in np.unique(columns["seed"]):
            mine = columns["seed"] == seed
            returns, distances = (
                columns["evaluation_return"][mine],
                columns["expert_distance"][mine],
            )
            kept, last, best = returns[distances.argmin()], returns[-1], returns.max()
            rank = stats.spearmanr(distances, returns).statistic
            print(
                f"{directory.name} seed {seed:.0f}: kept {kept:.0f}, last {last:.0f}, "
                f"best {best:.0f}, Spearman {rank:.2f}"
            )


if __name__ == "__main__":
    main()
