"""Experts: Brax's PPO and its evolution strategy on our environments."""

from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import ailsrs_jax as ail
from ailsrs_jax.envs import State
from tests.exploding import ExplodingPointMass
from tests.point_mass import EPISODE_LENGTH, PointMass

# Brax's own.
pytestmark = [
    pytest.mark.filterwarnings("ignore:jax.device_put_replicated is deprecated"),
    pytest.mark.filterwarnings("ignore:optax.global_norm is deprecated"),
]

SMALL: dict[str, Any] = {
    "num_env_steps": 100_000,
    "num_evaluations": 10,
    "num_evaluation_episodes": 8,
    "episode_length": EPISODE_LENGTH,
    "num_envs": 32,
    "unroll_length": 30,
    "num_minibatches": 4,
    "learning_rate": 3e-3,
    "discounting": 0.95,
    "gae_lambda": 0.9,
}


class Shifted(PointMass):
    """The same with actions from 1 to 5, of which 3 is no force."""

    action_low = np.array([1.0], np.float32)
    action_high = np.array([5.0], np.float32)

    def step(self, state: State, action: jax.Array) -> State:
        return super().step(state, (jnp.clip(action, 1.0, 5.0) - 3.0) / 2.0)


BOTH = pytest.mark.parametrize("env", [PointMass(), Shifted()], ids=["unit actions", "other"])


@pytest.mark.slow
@BOTH
def test_ppo_learns_and_its_mean_is_what_is_saved(env: PointMass, tmp_path: Path) -> None:
    reports: list[Any] = []
    path = tmp_path / "expert.npz"
    expert = ail.train_expert(env, output=path, watch=reports.append, **SMALL)
    returns = [float(report.metrics["evaluation_return"][0]) for report in reports]
    assert len(returns) == 10
    assert max(returns) > -20
    evaluation = ail.evaluate(expert, 50, env=env, episode_length=EPISODE_LENGTH)
    assert evaluation.mean > -25
    drawn = ail.evaluate(expert, 50, env=env, episode_length=EPISODE_LENGTH, stochastic=True)
    assert drawn.mean != evaluation.mean
    saved = ail.load_policy(path)
    np.testing.assert_array_equal(saved(np.zeros(2)), expert(np.zeros(2)))


def test_it_stops_at_a_level() -> None:
    reports: list[Any] = []
    settings = SMALL | {"stop_at": -30.0}
    expert = ail.train_expert(PointMass(), watch=reports.append, **settings)
    returns = [float(report.metrics["evaluation_return"][0]) for report in reports]
    assert all(mean < -30 for mean in returns[:-1])
    assert returns[-1] >= -30
    assert len(returns) < 10
    assert isinstance(expert, ail.SavedMlpPolicy)


def test_a_small_divergence_is_kept_by_small_steps() -> None:
    """The weights of the last layer start near zero, and a batch of steps moves them."""
    settings = SMALL | {"num_env_steps": 1000, "num_evaluations": 1}
    free, bound = (
        ail.train_expert(PointMass(), **settings, desired_kl=desired) for desired in (0.0, 1e-9)
    )
    assert np.abs(bound.weights[-1]).max() < 0.5 * np.abs(free.weights[-1]).max()


@BOTH
def test_training_goes_on_from_a_policy(env: PointMass) -> None:
    still: Any = SMALL | {"num_env_steps": 1000, "num_evaluations": 1, "learning_rate": 1e-9}
    first = ail.train_expert(env, **SMALL | {"num_env_steps": 5000, "num_evaluations": 1})
    again = ail.train_expert(env, start=first, seed=1, **still)
    observations = np.random.default_rng(0).normal(size=(20, 2))
    np.testing.assert_allclose(again(observations), first(observations), atol=1e-3)
    np.testing.assert_allclose(again.noise_std, first.noise_std, rtol=1e-4)
    other = ail.train_expert(env, seed=1, **still)
    assert np.abs(other(observations) - first(observations)).max() > 1e-2


@pytest.mark.slow
@BOTH
def test_evolution_learns_and_its_last_policy_is_saved(env: PointMass, tmp_path: Path) -> None:
    reports: list[Any] = []
    path = tmp_path / "expert.npz"
    settings = {
        "num_env_steps": 80_000,
        "num_evaluations": 4,
        "num_evaluation_episodes": 16,
        "episode_length": EPISODE_LENGTH,
        "hidden_size": 16,
        "learning_rate": 0.05,
    }
    expert = ail.train_expert(env, algorithm="es", output=path, watch=reports.append, **settings)
    returns = [float(report.metrics["evaluation_return"][0]) for report in reports]
    assert returns[-1] > max(-30, returns[0])
    evaluation = ail.evaluate(expert, 50, env=env, episode_length=EPISODE_LENGTH)
    assert evaluation.mean == pytest.approx(returns[-1], abs=6)
    saved = ail.load_policy(path)
    np.testing.assert_array_equal(saved(np.zeros(2)), expert(np.zeros(2)))
    assert not saved.is_stochastic


@pytest.mark.slow
def test_ppo_lives_with_episodes_that_diverge() -> None:
    reports: list[Any] = []
    # Several evaluations, because one in which an episode diverges keeps no policy.
    settings = SMALL | {"num_env_steps": 100_000, "num_evaluations": 10}
    expert = ail.train_expert(ExplodingPointMass(0.05), watch=reports.append, **settings)
    assert isinstance(expert, ail.SavedMlpPolicy)  # which are finite
    assert len(reports) == 10
    with pytest.raises(ail.UserError, match=r"^stopped: 8 of 8 episodes of"):
        ail.train_expert(ExplodingPointMass(1.0), **settings)


def test_the_environment_says_how_long_episodes_are() -> None:
    few = {"num_iterations": 1, "num_directions": 1, "num_top_directions": 1}
    env = "gymnasium:tests.workers.environments:Plain-v0"
    expert = ail.train_expert(env, algorithm="ars", num_evaluation_episodes=1, **few)
    assert expert.episode_length == 40
    assert ail.demonstrate(expert, 1).lengths.max() <= 40


def test_mistakes() -> None:
    linear = ail.SavedLinearPolicy(
        env_id="PointMass",
        mean=np.zeros(2),
        std=np.ones(2),
        action_low=-np.ones(1),
        action_high=np.ones(1),
        weights=np.zeros((1, 2)),
    )
    with pytest.raises(ail.UserError, match="goes on from a Gaussian policy of two layers of 64"):
        ail.train_expert(PointMass(), start=linear, **SMALL)
    path: Any = "expert.npz"
    with pytest.raises(ail.UserError, match="this is no policy: 'expert"):
        ail.train_expert(PointMass(), start=path, **SMALL)
    with pytest.raises(ail.UserError, match="ars starts anew: leave out start"):
        ail.train_expert(PointMass(), algorithm="ars", start=linear)
    with pytest.raises(ail.UserError, match="unknown algorithm 'sac': use one of ppo, es, ars"):
        ail.train_expert(PointMass(), algorithm="sac")
    with pytest.raises(ail.UserError, match="num_envs is 32: it must be a multiple of"):
        ail.train_expert(PointMass(), **SMALL | {"num_minibatches": 5})
