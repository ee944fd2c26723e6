"""Train an expert of Ant that hardly ever jumps too high or turns over.

usage: python -m experiments.ant_expert DIRECTORY    (writes stage_0.npz, stage_1.npz, ...)

A policy of PPO on the task as it is ends about four of a hundred episodes above the healthy
heights, and lies on its back at the end of five others. The later stages go on from the policy
before. The healthy heights are narrower there and their reward is higher, and a discount factor
closer to 1 and larger batches make a rare fall count. A stage whose file exists is left out.
"""

import dataclasses
import sys
from pathlib import Path
from typing import Any

import ailsrs_jax as ail
from ailsrs_jax.runs.storage.metrics import IterationReport

Values = dict[str, Any]
SAFE: Values = {"healthy_z_range": (0.3, 0.95), "healthy_reward": 4.0}
CAREFUL: Values = {"num_envs": 128, "discounting": 0.998, "reward_scaling": 0.02}
STAGES: list[tuple[Values, Values]] = [  # flags of the task, and settings
    (
        {},
        {
            "num_env_steps": 10_649_600,
            "num_evaluations": 26,
            "num_envs": 64,
            "desired_kl": 0.01,
            "init_noise_std": 0.35,
        },
    ),
    (SAFE, CAREFUL | {"num_env_steps": 4_587_520, "num_evaluations": 20, "desired_kl": 0.005}),
    (
        SAFE,
        CAREFUL
        | {
            "num_env_steps": 11_468_800,
            "num_evaluations": 50,
            "num_evaluation_episodes": 128,
            "desired_kl": 0.002,
        },
    ),
]
COMMON: Values = {"num_evaluation_episodes": 64, "unroll_length": 256, "num_minibatches": 32}


def main() -> None:
    """Train the stages whose files do not exist."""
    directory, policy = Path(sys.argv[1]), None
    for number, (flags, settings) in enumerate(STAGES):
        path = directory / f"stage_{number}.npz"
        if not path.exists():
            env = ail.make_env("ant", "mujoco", **flags)
            so_far = directory / "best_so_far.npz"
            best = ail.train_expert(
                env, start=policy, output=so_far, watch=report, **COMMON | settings
            )
            dataclasses.replace(best, env_id="Ant-v5").save(path)
        policy = ail.load_policy(path)


def report(progress: IterationReport) -> None:
    """Print what an evaluation has measured."""
    numbers = {name: float(values[0]) for name, values in progress.metrics.items()}
    print(f"{progress.iteration + 1}/{progress.num_iterations}", numbers, flush=True)


if __name__ == "__main__":
    main()
