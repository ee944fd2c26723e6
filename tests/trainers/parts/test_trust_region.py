"""TRPO and GAIL: what they have in common, and that they learn."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ailsrs_jax.data.demonstrations import Demonstrations
from ailsrs_jax.errors import UserError
from ailsrs_jax.trainers.gail import GailSettings, make_gail
from ailsrs_jax.trainers.trpo import TrpoSettings, make_trpo
from tests.point_mass import EPISODE_LENGTH, PointMass

SMALL: dict[str, Any] = {
    "num_iterations": 20,
    "updates_per_iteration": 4,
    "num_envs": 8,
    "batch_size": 960,
    "discount": 0.97,
    "advantage_decay": 0.9,
    "episode_length": EPISODE_LENGTH,
    "max_divergence": 0.03,
    "num_evaluation_episodes": 16,
}


@pytest.mark.slow
def test_trpo_learns_from_the_reward(point_mass: PointMass) -> None:
    """A point that is left alone drifts away, to a return of about −90."""
    trainer = make_trpo(point_mass, TrpoSettings(**SMALL))
    state, metrics = jax.jit(trainer.train)(jax.random.key(0))
    assert metrics["evaluation_return"][0] < -40
    assert metrics["evaluation_return"][-1] > -20
    assert float(state.kept.score) == float(metrics["evaluation_return"].max())
    assert (metrics["divergence"] <= 1.5 * 0.03 + 1e-6).all()
    assert (metrics["divergence"] > 0).any()
    assert metrics["action_std"][-1] < metrics["action_std"][0] == 1.0


@pytest.mark.slow
@pytest.mark.parametrize("sees", ["state_action", "state_next_state"])
def test_gail_imitates(sees: str, point_mass: PointMass, point_mass_expert: Demonstrations) -> None:
    settings = GailSettings(
        **SMALL,
        discriminator_sees=sees,
        discriminator_steps=20,
        gradient_penalty=1.0,  # without it the end is upset at times, on some processors
        num_distance_samples=500,
    )
    trainer = make_gail(point_mass, point_mass_expert, settings)
    _, metrics = jax.jit(trainer.train)(jax.random.key(0))
    assert metrics["evaluation_return"][0] < -40
    assert metrics["evaluation_return"][-3:].mean() > -25
    assert metrics["expert_distance"][-1] < 0.3 * metrics["expert_distance"][0]


@pytest.mark.slow
def test_gail_gets_there_without_a_penalty(
    point_mass: PointMass, point_mass_expert: Demonstrations
) -> None:
    settings = GailSettings(**SMALL, discriminator_steps=20, num_distance_samples=500)
    trainer = make_gail(point_mass, point_mass_expert, settings)
    _, metrics = jax.jit(trainer.train)(jax.random.key(1))
    assert metrics["evaluation_return"][0] < -40
    assert metrics["evaluation_return"].max() > -15  # where it ends is upset at times


def test_cloning_gives_the_mean_and_what_it_misses_by(
    point_mass: PointMass, point_mass_expert: Demonstrations, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("ailsrs_jax.trainers.gail.CLONING_RATE", 3e-3)
    noise = 0.1 * np.random.default_rng(0).normal(size=point_mass_expert.actions.shape)
    noisy = point_mass_expert.replace(actions=point_mass_expert.actions + np.float32(noise))
    settings = GailSettings(**SMALL, behavior_cloning_start=True, behavior_cloning_steps=1500)
    trainer = make_gail(point_mass, noisy, settings)
    actor = trainer.init(jax.random.key(0)).actor_critic.actor
    np.testing.assert_allclose(jnp.exp(actor.log_std), 0.1, rtol=0.15)


def test_does_not_retrace(point_mass: PointMass, point_mass_expert: Demonstrations) -> None:
    trainer = make_gail(point_mass, point_mass_expert, GailSettings(**SMALL))
    update, state = jax.jit(trainer.update), jax.jit(trainer.init)(jax.random.key(0))
    for _ in range(2):
        state, _ = update(state)
    assert update._cache_size() == 1


def test_environments_must_share_a_batch_evenly(point_mass: PointMass) -> None:
    with pytest.raises(UserError, match="batch_size is 961: it must be a multiple of num_envs, 8"):
        make_trpo(point_mass, TrpoSettings(**SMALL | {"batch_size": 961}))
