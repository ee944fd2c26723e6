import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ailsrs_jax.components.linear_regression import ridge_regression
from ailsrs_jax.data.demonstrations import Demonstrations
from ailsrs_jax.trainers.behavior_cloning import (
    BehaviorCloning,
    BehaviorCloningSettings,
    make_behavior_cloning,
    training_lengths,
)
from tests.point_mass import EPISODE_LENGTH, EXPERT_WEIGHTS, PointMass

SMALL = BehaviorCloningSettings(
    num_iterations=60, gradient_steps=200, episode_length=EPISODE_LENGTH, num_distance_samples=100
)


@pytest.fixture
def trainer(point_mass: PointMass, point_mass_expert: Demonstrations) -> BehaviorCloning:
    """With noise on the actions, so that no weights fit them all."""
    noise = 0.1 * np.random.default_rng(0).normal(size=point_mass_expert.actions.shape)
    noisy = point_mass_expert.replace(actions=point_mass_expert.actions + np.float32(noise))
    return make_behavior_cloning(point_mass, noisy, SMALL)


def test_adam_ends_at_the_exact_solution(trainer: BehaviorCloning) -> None:
    expert = trainer.reference
    lengths = training_lengths(expert.lengths, SMALL.validation_fraction)
    training = jnp.arange(EPISODE_LENGTH) < lengths[:, None]
    exact = ridge_regression(expert.observations, expert.actions, training, penalty=0.0)
    state, metrics = jax.jit(trainer.train)(jax.random.key(0))
    np.testing.assert_allclose(state.weights, exact, atol=0.01)
    assert metrics["training_loss"][-1] <= 1.01 * trainer._loss(exact, training)


def test_ridge_finds_it_in_one_iteration(trainer: BehaviorCloning) -> None:
    trainer = dataclasses.replace(trainer, settings=dataclasses.replace(SMALL, solver="ridge"))
    state, _ = jax.jit(trainer.update)(trainer.init(jax.random.key(0)))
    assert bool(state.finished)
    # In units of the expert's standard deviation, and with actions that are noisy by 0.1.
    np.testing.assert_allclose(
        state.kept.policy.weights / state.kept.policy.std, EXPERT_WEIGHTS, atol=0.05
    )


def test_it_ends_when_nothing_gets_better(trainer: BehaviorCloning) -> None:
    trainer = dataclasses.replace(trainer, settings=dataclasses.replace(SMALL, patience=3))
    update = jax.jit(trainer.update)
    state, losses = trainer.init(jax.random.key(0)), []
    while not bool(state.finished):
        state, metrics = update(state)
        losses.append(float(metrics["validation_loss"]))
        assert len(losses) <= SMALL.num_iterations
    best = int(np.argmin(losses))
    assert len(losses) == best + 1 + 3
    assert int(state.kept.iteration) == best
    assert update._cache_size() == 1


@settings(deadline=None)
@given(
    st.lists(st.integers(1, 50), min_size=1, max_size=12),
    st.floats(0.01, 1.0),
)
def test_something_is_left_to_train_on(lengths: list[int], fraction: float) -> None:
    kept = np.asarray(training_lengths(jnp.array(lengths), fraction))
    assert ((kept >= 0) & (kept <= lengths)).all()
    assert kept.sum() >= 1
    if len(lengths) > 1:  # whole episodes, and something is left to validate with
        assert ((kept == 0) | (kept == lengths)).all()
        assert (kept == 0).any()
    elif lengths[0] > 1:
        assert kept[0] < lengths[0]
