"""Environments as objects: an expert, its demonstrations, imitation and evaluation in Python."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from brax import envs
from brax.envs.wrappers.training import EpisodeWrapper

import ailsrs_jax as ail
from ailsrs_jax.trainers.algorithms import preset_settings
from tests.point_mass import EXPERT_WEIGHTS, PointMass, linear_policy

SEARCH = {"num_iterations": 2, "num_directions": 2, "num_top_directions": 1, "episode_length": 10}
TINY = SEARCH | {"discriminator_batch_size": 16, "memory_samples": 16, "num_distance_samples": 50}
TINY |= {"leave_out_beyond": 0.0}


def spring() -> ail.SavedPolicy:
    """The point mass's expert."""
    return linear_policy(EXPERT_WEIGHTS)


def there_and_back(env: Any, env_id: str, physics: str, output: Path) -> None:
    """Take all steps of docs/own_task.md, each with tiny settings."""
    path = output / "expert.npz"
    expert = ail.train_expert(env, algorithm="ars", seed=1, output=path, **SEARCH)
    assert ail.load_policy(output / "expert.npz").env_id == expert.env_id == env_id
    demonstrations = ail.demonstrate(expert, 3, env=env, episode_length=10)
    ail.save_demonstrations(demonstrations, output / "demonstrations.npz")
    run = ail.train(env, output / "demonstrations.npz", output=output / "run", **TINY)
    config = json.loads((output / "run" / "config.json").read_text())
    assert (config["env_id"], config["physics"]) == (env_id, physics)
    policy = ail.load_policy(output / "run" / "seed_0" / "policy.npz")
    np.testing.assert_array_equal(policy.weights, run.policies[0].weights)
    evaluation = ail.evaluate(policy, 2, env=env, episode_length=20)
    assert evaluation.returns.shape == (2,)
    assert (evaluation.lengths <= 20).all()


def test_the_whole_loop(tmp_path: Path) -> None:
    there_and_back(envs.get_environment("fast"), "Fast", "jax", tmp_path)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:Brax System", "ignore:Accessing `")
def test_the_whole_loop_with_simulated_physics(tmp_path: Path) -> None:
    env = envs.get_environment("inverted_pendulum", backend="mjx")
    there_and_back(env, "InvertedPendulum", "mjx", tmp_path)
    batch = {"num_envs": 4, "batch_size": 40, "episode_length": 10, "num_iterations": 1}
    assert len(ail.train(env, algorithm="trpo", **batch).policies) == 1


def test_the_whole_loop_in_mujoco_playground(tmp_path: Path) -> None:
    playground = pytest.importorskip("mujoco_playground")
    env = playground.registry.load("CartpoleBalance", config_overrides={"impl": "jax"})
    there_and_back(env, "Balance", "jax", tmp_path)


def test_a_wrapper_may_limit_the_time() -> None:
    env = EpisodeWrapper(PointMass(), 5, 1)
    demonstrations = ail.demonstrate(spring(), 2, env=env)
    assert demonstrations.lengths.tolist() == [5, 5]
    assert demonstrations.env_id == "PointMass"


def test_evaluation_has_a_time_limit_everywhere() -> None:
    assert ail.evaluate(spring(), 2, env=PointMass(), episode_length=4).lengths.tolist() == [4, 4]
    still = linear_policy(np.zeros((2, 8)), "Swimmer-v5")
    for physics in ("gymnasium", "mujoco"):
        assert ail.evaluate(still, 1, physics, episode_length=4).lengths.tolist() == [4]
    with pytest.raises(ail.UserError, match="1 episodes of 0 steps"):
        ail.evaluate(still, 1, episode_length=0)


def test_mistakes_are_named(point_mass_expert: ail.Demonstrations) -> None:
    env, policy = PointMass(), spring()
    calls = {
        "pass the environment itself as env": lambda: ail.evaluate(policy),
        "unknown environment 'PointMass'": lambda: ail.demonstrate(policy, 1),
        "no expert of PointMass ships": lambda: ail.train(env),
        "are of PointMass, not of Fast": lambda: ail.train(
            envs.get_environment("fast"), point_mass_expert
        ),
        "1 observations and 1 actions: the environment has 2 and 1": lambda: ail.train(
            env, point_mass_expert.replace(observations=np.zeros((8, 60, 1), np.float32))
        ),
        "takes 2 observations and gives 1 actions: the environment has 8 and 2": lambda: (
            ail.evaluate(policy, env=ail.make_env("swimmer"))
        ),
        "an environment has its own": lambda: ail.train(env, point_mass_expert, physics="mjx"),
        "a class": lambda: ail.train_expert(PointMass),
        "no setting 'step_size'": lambda: ail.train_expert(env, step_size=1),
        "2 trajectories of 0 steps": lambda: ail.demonstrate(policy, 2, env=env, episode_length=0),
    }
    for message, call in calls.items():
        with pytest.raises(ail.UserError) as caught:
            call()
        assert message in str(caught.value)


def test_settings_of_a_task_without_a_preset() -> None:
    tuned, paper = (preset_settings("PointMass", preset) for preset in ("tuned", "paper"))
    assert tuned.num_iterations == 84
    assert tuned.gradient_penalty == preset_settings("Hopper-v5", "tuned").gradient_penalty
    assert paper == ail.AilsrsSettings()
    assert preset_settings("PointMass", "tuned", "ars") == ail.ArsSettings()
