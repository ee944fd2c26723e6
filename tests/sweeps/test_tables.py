"""The tables of a sweep: what they say of its cells, and what they leave empty."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import ailsrs_jax as ail
from ailsrs_jax.components.policy import LinearPolicy
from ailsrs_jax.runs.evaluation import evaluate_random
from ailsrs_jax.runs.storage.journal import Result
from ailsrs_jax.runs.storage.policies import saved_policy
from ailsrs_jax.sweeps import tables
from ailsrs_jax.sweeps.spec import expand
from ailsrs_jax.sweeps.tables import finished_row, save_row, write_tables
from tests.sweeps.synthetic_sweep import COLUMNS, CURVE_COLUMNS, TIMING_COLUMNS
from tests.sweeps.toy_sweep import POINT_MASS, grid, quick_grid, table


def test_what_a_sweep_says(demonstrations: str) -> None:
    cloning = {"num_iterations": 3, "episode_length": 20}  # compiles quickly
    spec = grid(demonstrations, algorithm="bc", num_trajectories=[2, 8]) | {"settings": cloning}
    rows = ail.sweep(spec, "sweep")
    written = table(Path("sweep/results.csv"))
    curves = table(Path("sweep/curves.csv"))
    timings = table(Path("sweep/timings.csv"))
    assert tuple(written[0]) == COLUMNS
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
        random = evaluate_random(POINT_MASS, "auto", 20).mean
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
        assert (row["status"], row["label"], row["physics"]) == ("done", "BC", "none")


def test_episodes_of_another_length_than_the_experts_are_not_compared(
    in_tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tables, "random_return", lambda *_: -1.0)  # which takes seconds
    settings = {"num_iterations": 1, "episode_length": [100, 1000]}
    entry = {"algorithm": "ars", "settings": settings, "seeds": [0, 1]}
    grid = expand({"env": "swimmer", "grid": [entry]})
    policy = LinearPolicy(np.zeros((2, 8)), np.zeros(8), np.ones(8), -np.ones(2), np.ones(2))
    for cell in grid.cells[::2]:  # the others have not run
        directory = Path("sweep/cells", cell.name)
        directory.mkdir(parents=True)
        content = "iteration,seed,env_steps,evaluation_return\n0,0,100,2.0\n1,0,400,1000.0\n"
        (directory / "metrics.csv").write_text(content)
        config = cell.make_plan().config
        result = Result(
            config, {0: saved_policy(policy, "Swimmer-v5")}, {0: 1}, {0: -0.2}, np.ones(3), 1000
        )
        save_row(directory, finished_row(cell, result, directory, episodes=1), None)
    short, _, whole, not_run = write_tables(Path("sweep"), grid.cells)
    measured = ("last_return", "mean_return_over_training", "steps_to_90")
    assert [short[name] for name in measured] == [None] * 3
    assert [whole[name] for name in measured] == [1000, 750.5, 100]
    assert (short["length_mean"], whole["length_mean"]) == (100, 1000)
    assert short["normalized"] is None
    assert whole["normalized"] == (whole["return_mean"] + 1) / 2
    assert (not_run["status"], whole["status"]) == ("not run", "done")

    ail.report_sweep("sweep")
    text = Path("sweep/table.md").read_text()
    rows = [line for line in text.splitlines() if "| 1 of 2 |" in line and "Swimmer" not in line]
    assert [line.endswith("| – | – | – |") for line in rows if "| 1 |" in line] == [True, False]
    assert "## Not run" in text
    assert "| 2 of 4 cells |" in text
    assert "## Failed" not in text


def again(row: dict[str, Any]) -> dict[str, Any]:
    """Evaluate the only cell of the sweep again, and return its row."""
    Path("sweep/cells", row["cell"], "row.json").unlink()
    (row,) = ail.sweep(quick_grid(), "sweep")
    return dict(row)


def test_a_cell_is_evaluated_again(in_tmp_path: Path) -> None:
    (row,) = ail.sweep(quick_grid(), "sweep")
    directory = Path("sweep/cells", row["cell"])
    (timing,) = table(Path("sweep/timings.csv"))
    times = [float(line["seconds"]) for line in table(directory / "seconds.csv")]
    assert float(timing["train_seconds"]) == pytest.approx(sum(times))
    assert float(timing["compile_seconds"]) > 0
    assert again(row) == row
    assert table(Path("sweep/timings.csv")) == [timing]

    # An evaluation that diverged does not count.
    path = directory / "metrics.csv"
    metrics = table(path)
    path.write_text(path.read_text().replace(metrics[1]["evaluation_return"], "nan"))
    returns, steps = (
        np.array([float(line[name]) for line in metrics])
        for name in ("evaluation_return", "env_steps")
    )
    left = np.array([True, False, True])
    expected = np.average(returns[left], weights=np.diff(steps, prepend=0)[left])
    assert again(row)["mean_return_over_training"] == pytest.approx(expected)
