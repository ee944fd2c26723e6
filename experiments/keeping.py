"""Measure how good the reward-free choice of the kept policy is, from the results of a sweep.

usage: python experiments/keeping.py DIRECTORY     (experiments/results/paper, or any sweep's)

For each cell of AILSRS and GAIL, it prints the evaluation return of three iterates: the kept one,
which was chosen by its energy distance to the expert; the last one; and the best one, which only
the reward can identify. It also prints Spearman's rank correlation of distance and return over the
iterates.
"""

import sys
from collections import defaultdict
from pathlib import Path

import numpy as np
from scipy import stats

from ailsrs_jax.sweeps.results import read_results, read_table


def main() -> None:
    """Print one row for each cell."""
    directory = Path(sys.argv[1])
    kept_iterations = {
        cell.cell: cell.kept_iteration
        for cell in read_results(directory).done
        if cell.algorithm in ("ailsrs", "gail")
    }
    wanted = ("iteration", "evaluation_return", "expert_distance")
    curves = defaultdict(list)
    for _, row in read_table(directory / "curves.csv", wanted):
        if row["cell"] in kept_iterations:
            curves[row["cell"]].append([float(row[column]) for column in wanted])
    print("| cell | kept | last | best | Spearman |")
    print("|---|---|---|---|---|")
    for cell, curve in curves.items():
        iterations, returns, distances = np.array(curve).T
        (kept,) = returns[iterations == kept_iterations[cell]]
        rank = stats.spearmanr(distances, returns).statistic if len(returns) > 1 else np.nan
        print(f"| {cell} | {kept:.0f} | {returns[-1]:.0f} | {returns.max():.0f} | {rank:.2f} |")


if __name__ == "__main__":
    main()
