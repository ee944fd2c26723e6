"""What the tables of a sweep say of its cells, and what they leave out."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import ailsrs_jax as ail
from ailsrs_jax.runs.evaluation import evaluate_random
from ailsrs_jax.sweeps.tables import CURVE_COLUMNS, RESULT_COLUMNS, TIMING_COLUMNS
from tests.sweeps.toy_sweep import POINT_MASS, grid, quick_grid, table


def test_what_a_sweep_says(demonstrations: str) -> None:
    spec = grid(demonstrations, num_trajectories=[2, 8])
    rows = ail.sweep(spec, "sweep")
    written = table(Path("sweep/results.csv"))
    curves = table(Path("sweep/curves.csv"))
    timings = table(Path("sweep/timings.csv"))
    assert tuple(written[0]) == RESULT_COLUMNS
    assert tuple(curves[0]) == CURVE_COLUMNS
    assert tuple(timings[0]) == TIMING_COLUMNS
    names = [row["cell"] for row in rows]
    assert [row["cell"] for row in timings] == names
    assert [(row["cell"], row["iteration"]) for row in curves] == [
        (name, str(iteration)) for name in names for iteration in range(3)
    ]
    expert = ail.load_demonstrations(demonstrations)
    for row, number in zip(written, (2, 8), strict=True):
        mine = [curve for curve in curves if curve["cell"] == row["cell"]]
        returns, steps = (
            np.array([float(curve[name]) for curve in mine])
            for name in ("evaluation_return", "env_steps")
        )
        policy = ail.load_policy(Path("sweep/cells", row["cell"], "seed_0/policy.npz"))
        evaluation = ail.evaluate(policy, 2, "auto", episode_length=20)
        random = evaluate_random(POINT_MASS, physics="auto", episode_length=20).mean
        level = np.mean(expert.returns[:number])
        expected = {
            "num_trajectories": number,
            "iterations": 3,
            "env_steps": steps[-1],
            "return_mean": evaluation.mean,
            "return_std": evaluation.std,
            "length_mean": evaluation.lengths.mean(),
            "last_return": returns[-1],
            "mean_return_over_training": np.average(returns, weights=np.diff(steps, prepend=0)),
            "expert_return": level,
            "random_return": random,
            "normalized": (evaluation.mean - random) / (level - random),
        }
        for name, value in expected.items():
            assert float(row[name]) == pytest.approx(value), name
        reached = returns >= level - 0.1 * abs(level)
        assert row["steps_to_90"] == (str(int(steps[reached.argmax()])) if reached.any() else "")
        assert (row["status"], row["label"], row["physics"]) == ("done", "AILSRS", "none")


def test_episodes_of_another_length_than_gymnasiums_are_not_compared(in_tmp_path: Path) -> None:
    settings = {"solver": "ridge", "num_iterations": 1, "num_evaluation_episodes": 1}
    cloning = {"algorithm": "bc", "num_trajectories": 1, "settings": settings}
    settings["episode_length"] = [100, 1000]
    short, whole = ail.sweep({"env": "swimmer", "episodes": 1, "grid": [cloning]}, "sweep")
    measured = ("last_return", "mean_return_over_training")
    assert all(short[name] is None for name in (*measured, "steps_to_90"))
    assert all(whole[name] is not None for name in measured)
    assert short["length_mean"] == whole["length_mean"] == 1000
    ail.report_sweep("sweep")
    rows = [
        line for line in Path("sweep/table.md").read_text().splitlines() if "| 1 | 1 of 1 |" in line
    ]
    assert [line.endswith("| – | – | – |") for line in rows] == [True, False]


def again(row: dict[str, Any]) -> dict[str, Any]:
    """The row of the only cell of the sweep, evaluated once more."""
    Path("sweep/cells", row["cell"], "row.json").unlink()
    (row,) = ail.sweep(quick_grid(), "sweep")
    return dict(row)


def test_a_cell_that_was_not_timed_throughout_has_no_times(in_tmp_path: Path) -> None:
    (row,) = ail.sweep(quick_grid(), "sweep")
    seconds = Path("sweep/cells", row["cell"], "seconds.csv")
    assert len(table(Path("sweep/timings.csv"))) == 1
    lines = seconds.read_text().splitlines(keepends=True)
    for content in ("".join(lines[:-1]), "".join(lines) + "1,,\n", None):
        seconds.unlink() if content is None else seconds.write_text(content)
        assert again(row) == row
        assert table(Path("sweep/timings.csv")) == []


def test_an_evaluation_that_diverged_does_not_count_over_training(in_tmp_path: Path) -> None:
    (row,) = ail.sweep(quick_grid(), "sweep")
    path = Path("sweep/cells", row["cell"], "metrics.csv")
    metrics = table(path)
    path.write_text(path.read_text().replace(metrics[1]["evaluation_return"], "nan"))
    returns, steps = (
        np.array([float(line[name]) for line in metrics])
        for name in ("evaluation_return", "env_steps")
    )
    left = np.array([True, False, True])
    expected = np.average(returns[left], weights=np.diff(steps, prepend=0)[left])
    assert again(row)["mean_return_over_training"] == pytest.approx(expected)


def test_cells_that_have_not_run_are_counted(in_tmp_path: Path) -> None:
    spec = quick_grid(seeds=[0, 1, 2])
    rows = ail.sweep(spec, "sweep", shard=(1, 3), max_parallel=1)
    statuses = [row["status"] for row in rows]
    assert sorted(statuses) == ["done", "not run", "not run"]
    assert [row["status"] for row in table(Path("sweep/results.csv"))] == statuses
    ail.report_sweep("sweep")
    text = Path("sweep/table.md").read_text()
    assert "| 1 of 3 |" in text
    assert "## Not run" in text
    assert "| 2 of 3 cells |" in text
    assert "## Failed" not in text
