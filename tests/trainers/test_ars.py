"""Augmented random search on the reward."""

import dataclasses

import jax
import numpy as np

from ailsrs_jax.trainers.ars import ArsSettings, make_ars
from tests.point_mass import PointMass

SETTINGS = ArsSettings(
    num_iterations=10,
    num_directions=8,
    num_top_directions=4,
    step_size=0.3,
    noise_std=0.3,
    episode_length=60,
    num_evaluation_episodes=64,
)


def test_it_climbs() -> None:
    """The reward of the point mass is −x², so a return is at most 0."""
    _, metrics = jax.jit(make_ars(PointMass(), SETTINGS).train)(jax.random.key(0))
    returns = np.asarray(metrics["evaluation_return"])
    assert returns[0] < -90.0
    assert returns[-3:].mean() > -20.0


def test_the_survival_bonus_is_taken_from_each_step() -> None:
    """With a bonus of a thousand, the search prefers the episodes that end first."""
    settings = dataclasses.replace(SETTINGS, survival_bonus=1000.0)
    _, metrics = jax.jit(make_ars(PointMass(), settings).train)(jax.random.key(0))
    lengths = np.asarray(metrics["evaluation_length"])
    assert lengths[0] > 45
    assert lengths[-3:].mean() < 30
