"""Train the experts of Ant and Humanoid in the package, which hardly ever fall.

usage: python -m experiments.steady_experts ENV DIRECTORY
                                            (writes stage_0.npz, stage_1.npz, expert.npz)

The first stage is ``ailsrs expert ENV``. Its policy of Ant ends about four of a hundred episodes
above the healthy heights, and lies on its back at the end of five others. That of Humanoid walks so
low that three of four episodes end. The second stage goes on from it, with narrower healthy
heights. On Ant the expert is its policy with 0.8 of the torques, which walks a tenth slower. None
of 200 episodes of Ant failed, and 2 of 200 of Humanoid. A stage whose file exists is left out.
"""

import dataclasses
import sys
from pathlib import Path
from typing import Any, NamedTuple

import ailsrs_jax as ail
from ailsrs_jax.data.policies import SavedMlpPolicy
from ailsrs_jax.runs.storage.metrics import IterationReport


class Second(NamedTuple):
    """The second stage of a task."""

    flags: dict[str, Any]  # of the environment
    settings: dict[str, Any]  # of PPO
    torques: float  # of those of the trained policy


SECOND = {
    # A higher reward for healthy steps, a discount factor closer to 1 and larger batches make a
    # rare fall count.
    "ant": Second(
        {"healthy_z_range": (0.3, 0.95), "healthy_reward": 4.0},
        {
            "num_env_steps": 4_587_520,
            "num_evaluations": 20,
            "num_evaluation_episodes": 64,
            "num_envs": 128,
            "unroll_length": 256,
            "num_minibatches": 32,
            "desired_kl": 0.005,
            "discounting": 0.998,
            "reward_scaling": 0.02,
        },
        0.8,
    ),
    "humanoid": Second(
        {"healthy_z_range": (1.05, 2.0)},
        {
            "num_env_steps": 4_194_304,
            "num_evaluations": 16,
            "num_evaluation_episodes": 64,
            "num_envs": 64,
            "unroll_length": 256,
            "num_minibatches": 32,
            "desired_kl": 0.01,
            "discounting": 0.99,
            "gae_lambda": 0.95,
            "reward_scaling": 0.05,
        },
        1.0,
    ),
}


def main() -> None:
    """Train the stages whose files do not exist, and write the expert."""
    env, directory = sys.argv[1], Path(sys.argv[2])
    flags, settings, torques = SECOND[env]
    first, second = (directory / f"stage_{number}.npz" for number in range(2))
    if not first.exists():
        ail.train_expert(env, physics="mujoco", watch=report).save(first)
    start = ail.load_policy(first)
    if not second.exists():
        narrow = ail.make_env(env, "mujoco", **flags)
        steady = ail.train_expert(narrow, start=start, watch=report, **settings)
        dataclasses.replace(steady, env_id=start.env_id).save(second)
    policy = ail.load_policy(second)
    assert isinstance(policy, SavedMlpPolicy)
    (*weights, last), (*biases, bias) = policy.weights, policy.biases
    gentle = {"weights": (*weights, torques * last), "biases": (*biases, torques * bias)}
    dataclasses.replace(policy, **gentle).save(directory / "expert.npz")


def report(progress: IterationReport) -> None:
    """Print what an evaluation has measured."""
    numbers = {name: float(values[0]) for name, values in progress.metrics.items()}
    print(f"{progress.iteration + 1}/{progress.num_iterations}", numbers, flush=True)


if __name__ == "__main__":
    main()
