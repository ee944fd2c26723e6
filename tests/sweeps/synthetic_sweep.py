"""The tables of a sweep, filled with made-up numbers."""

import csv
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ailsrs_jax.sweeps.results import CellResult

TASKS = {  # random and expert return
    "HalfCheetah-v5": (-280.0, 5450.0),
    "Hopper-v5": (18.0, 3240.0),
    "Walker2d-v5": (2.0, 2990.0),
    "Swimmer-v5": (0.5, 357.0),
}
HARD_TASKS = {"Ant-v5": (-50.0, 6000.0), "Humanoid-v5": (120.0, 7000.0)}
# Written out, because committed results have these columns.
COLUMNS = (
    *("cell", "label", "algorithm", "env_id", "preset", "settings"),
    *("demonstrations", "num_trajectories", "draw_from", "subsample", "states_only", "seed"),
    *("physics", "iterations", "env_steps", "kept_iteration", "return_mean", "return_std"),
    *("length_mean", "last_return", "mean_return_over_training", "steps_to_90"),
    *("expert_return", "random_return", "normalized", "status"),
)
CURVE_COLUMNS = (
    *("cell", "iteration", "env_steps", "evaluation_return", "evaluation_length"),
    *("expert_distance", "imitation_reward", "policy_score", "expert_score"),
)
TIMING_COLUMNS = (
    *("cell", "train_seconds", "compile_seconds", "seconds_to_90_percent", "hardware"),
)


def row(
    score: float,
    *,
    label: str = "AILSRS",
    env_id: str = "Hopper-v5",
    num_trajectories: int | str = 10,
    seed: int = 0,
    **changes: Any,
) -> dict[str, Any]:
    """Make the row of a cell whose kept policy has the normalized ``score``.

    ``changes`` replace columns. They may also set ``seconds``, the wall-clock time to 90 %, and
    ``curve``, a normalized learning curve.
    """
    random, expert = (TASKS | HARD_TASKS)[env_id]
    expert = changes.get("expert_return") or expert
    algorithm = label.lower()
    value = random + score * (expert - random)
    return {
        "cell": f"{algorithm}-{env_id}-{num_trajectories}-{seed}",
        "label": label,
        "algorithm": algorithm,
        "env_id": env_id,
        "preset": "tuned",
        "settings": "",
        "demonstrations": "",
        "num_trajectories": num_trajectories,
        "draw_from": "",
        "subsample": 1,
        "states_only": False,
        "seed": seed,
        "physics": "mujoco",
        "iterations": 40,
        "env_steps": 1_200_000,
        "kept_iteration": 33,
        "return_mean": value,
        "return_std": 20.0,
        "length_mean": 1000.0,
        "last_return": value,
        "mean_return_over_training": random + 0.6 * score * (expert - random),
        "steps_to_90": 500_000 if score >= 0.9 else "",
        "expert_return": expert,
        "random_return": random,
        "normalized": score,
        "status": "done",
    } | changes


def cells(*rows: dict[str, Any]) -> list[CellResult]:
    """Convert rows to what ``read_results`` returns."""
    return [
        CellResult(**{**values, "num_trajectories": values["num_trajectories"] or None})
        for values in rows
    ]


def curve(cell: dict[str, Any], generator: np.random.Generator) -> list[dict[str, Any]]:
    """Make the learning curve ``cell["curve"]``, or one that ends near the kept policy's return."""
    length = cell["iterations"]
    at = np.arange(length)
    if "curve" in cell:
        shape = np.interp(at, np.linspace(0, length - 1, len(cell["curve"])), cell["curve"])
        reach = cell["expert_return"] - cell["random_return"]
    else:
        shape = 1 - np.exp(-at / (length / 6)) + 0.06 * generator.standard_normal(length)
        reach = cell["return_mean"] - cell["random_return"]
    returns = cell["random_return"] + reach * shape
    steps = np.linspace(cell["env_steps"] / length, cell["env_steps"], length)
    return [
        {"cell": cell["cell"], "iteration": i, "env_steps": int(s), "evaluation_return": r}
        for i, s, r in zip(at, steps, returns)
    ]


def write_sweep(directory: Path, cells: Sequence[dict[str, Any]]) -> Path:
    """Write the three tables of ``cells`` (see ``row``)."""
    directory.mkdir(parents=True, exist_ok=True)
    generator = np.random.default_rng(0)
    done = [cell for cell in cells if cell["status"] == "done"]
    write_table(directory / "results.csv", COLUMNS, cells)
    curves = (point for cell in done for point in curve(cell, generator))
    write_table(directory / "curves.csv", CURVE_COLUMNS, curves)
    timings = (
        {
            "cell": cell["cell"],
            "train_seconds": 60.0,
            "compile_seconds": 5.0,
            "seconds_to_90_percent": cell.get("seconds", 25.0) if cell["steps_to_90"] else "",
            "hardware": "2 CPU cores",
        }
        for cell in done
    )
    write_table(directory / "timings.csv", TIMING_COLUMNS, timings)
    return directory


def write_table(path: Path, columns: Sequence[str], rows: Iterable[dict[str, Any]]) -> None:
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, columns, "", "ignore", lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
