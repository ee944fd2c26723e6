"""Evaluate the kept policies of a sweep where the world is not quite the one they were trained in.

usage: python -m experiments.robustness DIRECTORY    (writes robustness.json beside it)

DIRECTORY is that of ``ailsrs sweep experiments/search.toml``. The kept policies of the first seeds
of each task, and the neural expert that they imitate, run in Gymnasium's environment with each of
the CONDITIONS. A return is normalised as in the results: 0 is a random policy, 1 is the expert in
the unchanged environment, over its demonstrations.
"""

import json
import sys
import timeit
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from gymnasium.wrappers import TransformObservation

from ailsrs_jax.data.policies import SavedPolicy, load_policy
from ailsrs_jax.runs.demonstrate import expert_demonstrations
from ailsrs_jax.runs.policies import load_expert
from ailsrs_jax.show.sweep_report import markdown_table
from ailsrs_jax.sweeps.results import CellResult, read_results
from ailsrs_jax.sweeps.statistics import group_cells
from experiments.rules import short

RESULTS = Path(__file__).with_suffix(".json")
NUM_SEEDS = 5  # of each task
LEFT_OUT = ("Ant-v5",)  # its episodes take ten times as long
NUM_EPISODES = 20
SEED = 20_000  # of the first episode
NUM_CALLS = 10_000  # of a policy, to measure its time


def scale_mass(env: gymnasium.Env, factor: float) -> gymnasium.Env:
    """Multiply the mass and the inertia of every body."""
    model: Any = env.unwrapped.model  # type: ignore[attr-defined]
    model.body_mass[:] *= factor
    model.body_inertia[:] *= factor
    return env


def scale_friction(env: gymnasium.Env, factor: float) -> gymnasium.Env:
    """Multiply the sliding friction of every geom; Swimmer's is of the water, its viscosity."""
    model: Any = env.unwrapped.model  # type: ignore[attr-defined]
    model.geom_friction[:, 0] *= factor
    model.opt.viscosity *= factor
    return env


def add_noise(env: gymnasium.Env, scale: np.ndarray) -> gymnasium.Env:
    """Add Gaussian noise with the standard deviation ``scale (n,)`` to observations."""
    rng = np.random.default_rng(SEED)
    return TransformObservation(env, lambda o: o + scale * rng.standard_normal(len(scale)), None)


class LateActions(gymnasium.Wrapper):
    """Applies each action one step later; the first one is zero."""

    def reset(self, **options: Any) -> Any:
        """Begin an episode."""
        assert self.action_space.shape is not None
        self.action = np.zeros(self.action_space.shape)
        return self.env.reset(**options)

    def step(self, action: np.ndarray) -> Any:
        """Apply the action before this one."""
        applied, self.action = self.action, action
        return self.env.step(applied)


CONDITIONS: dict[str, Callable[[gymnasium.Env, np.ndarray], gymnasium.Env]] = {
    "unchanged": lambda env, _: env,
    "mass +10 %": lambda env, _: scale_mass(env, 1.1),
    "mass +20 %": lambda env, _: scale_mass(env, 1.2),
    "friction +10 %": lambda env, _: scale_friction(env, 1.1),
    "friction +20 %": lambda env, _: scale_friction(env, 1.2),
    "noise of 5 % of the observations' standard deviation": (
        lambda env, std: add_noise(env, 0.05 * std)
    ),
    "noise of 10 %": lambda env, std: add_noise(env, 0.1 * std),
    "actions one step late": lambda env, _: LateActions(env),
}


def main() -> None:
    """Measure the policies of a sweep."""
    (directory,) = map(Path, sys.argv[1:])
    rows = []
    for group in group_cells(read_results(directory).cells):
        if group.env_id in LEFT_OUT:
            continue
        first = group.cells[0]
        rows.append(measure(load_expert(first.env_id), first, "the expert"))
        for cell in group.cells[:NUM_SEEDS]:
            run = directory / "cells" / cell.cell
            policy = load_policy(run / f"seed_{cell.seed}" / "policy.npz")
            rows.append(measure(policy, cell, f"AILSRS, {cell.label}"))
        RESULTS.write_text(json.dumps(rows, indent=1) + "\n")
    print(table())


def measure(policy: SavedPolicy, cell: CellResult, label: str) -> dict[str, Any]:
    """Evaluate a policy of the task of ``cell`` under all conditions."""
    expert = expert_demonstrations(cell.env_id, 40, "mujoco")
    std = np.asarray(expert.observations)[np.asarray(expert.alive)].std(axis=0)
    scores = {}
    for name, change in CONDITIONS.items():
        env = change(gymnasium.make(cell.env_id), std)
        scores[name] = float(cell.normalize(mean_return(policy, env)))
    print(cell.env_id, label, {name: round(score, 2) for name, score in scores.items()}, flush=True)
    seconds = timeit.timeit(lambda: policy(policy.mean), number=NUM_CALLS)
    return {
        "env_id": cell.env_id,
        "label": label,
        "seed": cell.seed,
        "scores": scores,
        "numbers": sum(array.size for layer in policy.layers for array in layer),
        "microseconds": round(1e6 * seconds / NUM_CALLS, 1),
    }


def mean_return(policy: SavedPolicy, env: gymnasium.Env) -> float:
    """Return the mean over episodes of the sum of rewards."""
    total = 0.0
    for episode in range(NUM_EPISODES):
        observation, _ = env.reset(seed=SEED + episode)
        ended = False
        while not ended:
            observation, reward, terminated, truncated, _ = env.step(policy(observation))
            total, ended = total + float(reward), terminated or truncated
    return total / NUM_EPISODES


def table() -> str:
    """Return the results as Markdown: means over seeds, for each task and label."""
    groups: dict[tuple[str, str], list[dict[str, Any]]] = {}
    for row in json.loads(RESULTS.read_text()):
        groups.setdefault((row["env_id"], row["label"]), []).append(row)
    lines = []
    for (env_id, label), rows in groups.items():
        means = [np.mean([row["scores"][name] for row in rows]) for name in CONDITIONS]
        time = np.median([row["microseconds"] for row in rows])
        cells = [short(env_id), label, str(len(rows)), *(f"{mean:.2f}" for mean in means)]
        lines.append([*cells, f"{rows[0]['numbers']:,}", f"{time:.0f}"])
    header = ["task", "policy", "seeds", *CONDITIONS, "numbers", "µs an action in NumPy"]
    return markdown_table(header, lines)


if __name__ == "__main__":
    main()
