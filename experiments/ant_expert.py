"""Train the expert of Ant in the package, which hardly ever jumps too high or turns over.

usage: python -m experiments.ant_expert DIRECTORY    (writes stage_0.npz, stage_1.npz, expert.npz)

The first stage is ``ailsrs expert ant``. Its policy ends about four of a hundred episodes above the
healthy heights, and lies on its back at the end of five others. The second stage goes on from it.
The healthy heights are narrower there and their reward is higher, and a discount factor closer to 1
and larger batches make a rare fall count. The expert is its policy with 0.8 of the torques: it
walks a tenth slower, and none of 200 episodes failed. A stage whose file exists is left out.
"""

import dataclasses
import sys
from pathlib import Path

import ailsrs_jax as ail
from ailsrs_jax.data.policies import SavedMlpPolicy
from ailsrs_jax.runs.storage.metrics import IterationReport

TORQUES = 0.8  # of those of the trained policy


def main() -> None:
    """Train the stages whose files do not exist, and write the expert."""
    directory = Path(sys.argv[1])
    paths = [directory / f"stage_{number}.npz" for number in range(2)]
    if not paths[0].exists():
        ail.train_expert("ant", physics="mujoco", watch=report).save(paths[0])
    if not paths[1].exists():
        careful = ail.train_expert(
            ail.make_env("ant", "mujoco", healthy_z_range=(0.3, 0.95), healthy_reward=4.0),
            start=ail.load_policy(paths[0]),
            watch=report,
            num_env_steps=4_587_520,
            num_evaluations=20,
            num_evaluation_episodes=64,
            num_envs=128,
            unroll_length=256,
            num_minibatches=32,
            desired_kl=0.005,
            discounting=0.998,
            reward_scaling=0.02,
        )
        dataclasses.replace(careful, env_id="Ant-v5").save(paths[1])
    policy = ail.load_policy(paths[1])
    assert isinstance(policy, SavedMlpPolicy)
    (*weights, last), (*biases, bias) = policy.weights, policy.biases
    gentle = {"weights": (*weights, TORQUES * last), "biases": (*biases, TORQUES * bias)}
    dataclasses.replace(policy, **gentle).save(directory / "expert.npz")


def report(progress: IterationReport) -> None:
    """Print what an evaluation has measured."""
    numbers = {name: float(values[0]) for name, values in progress.metrics.items()}
    print(f"{progress.iteration + 1}/{progress.num_iterations}", numbers, flush=True)


if __name__ == "__main__":
    main()
