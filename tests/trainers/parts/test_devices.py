"""Many devices give what one gives: episodes bit for bit, what is summed to rounding."""

import dataclasses
import math
import re
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.sharding import Mesh

from ailsrs_jax.data.demonstrations import Demonstrations
from ailsrs_jax.errors import UserError
from ailsrs_jax.runs.storage.checkpoint import Checkpoints
from ailsrs_jax.trainers.ailsrs import Ailsrs, AilsrsSettings, make_ailsrs
from ailsrs_jax.trainers.ars import Ars, ArsSettings
from ailsrs_jax.trainers.parts.devices import AXIS, Devices
from ailsrs_jax.trainers.parts.exploration import explore
from tests.point_mass import (
    EPISODE_LENGTH,
    WIDE_ACTION,
    WIDE_OBSERVATION,
    PointMass,
    WidePointMass,
    wide_demonstrations,
)

SETTINGS = AilsrsSettings(
    num_iterations=3,
    num_directions=8,
    num_top_directions=4,
    step_size=0.1,
    final_step_size=0.1,
    noise_std=0.1,
    episode_length=EPISODE_LENGTH,
    discriminator_batch_size=64,
    gradient_penalty=1.0,
    memory_iterations=2,
    memory_samples=160,
    num_distance_samples=100,
)


def devices(count: int) -> Devices:
    return Devices(Mesh(np.array(jax.devices()[:count]), (AXIS,)))


@pytest.fixture
def alone(point_mass: PointMass, point_mass_expert: Demonstrations) -> Ailsrs:
    return make_ailsrs(point_mass, point_mass_expert, SETTINGS)


def test_a_run_on_many_devices(alone: Ailsrs) -> None:
    """Three iterations of two seeds, as the command line runs them."""
    many = dataclasses.replace(alone, devices=devices(4))
    seeds = jnp.array([0, 3])
    results = [
        jax.jit(jax.vmap(lambda seed, t=trainer: t.train(jax.random.key(seed))))(seeds)
        for trainer in (alone, many)
    ]
    (state, metrics), (many_state, many_metrics) = results
    for name, values in metrics.items():
        np.testing.assert_allclose(many_metrics[name], values, rtol=2e-3, atol=1e-4, err_msg=name)
    np.testing.assert_allclose(many_state.weights, state.weights, rtol=1e-3, atol=1e-4)
    np.testing.assert_array_equal(many_state.memory.lengths, state.memory.lengths)
    np.testing.assert_allclose(many_state.memory.steps, state.memory.steps, atol=1e-3)
    assert float(jnp.abs(state.weights).max()) > 0.1  # they went somewhere


def test_directions_and_episodes_are_the_same_bits(point_mass: PointMass, alone: Ailsrs) -> None:
    state = alone.init(jax.random.key(0))
    deltas = jax.random.normal(jax.random.key(1), (8, *state.weights.shape))

    def lengths_and_returns(where: Devices) -> tuple[jax.Array, ...]:
        def on_one_device() -> tuple[jax.Array, ...]:
            batch = explore(
                point_mass,
                alone.policy(state.weights, state.statistics),
                deltas,
                jax.random.key(2),
                noise_std=1.0,
                num_evaluation_episodes=2,
                episode_length=EPISODE_LENGTH,
                devices=where,
                batch_size=None,
            )
            by_pair = (values[2:].reshape(2, -1) for values in (batch.lengths, batch.env_returns))
            return tuple(where.gather(values, axis=1) for values in by_pair)

        return jax.jit(where.split(on_one_device, jax.sharding.PartitionSpec()))()

    expected = lengths_and_returns(Devices())
    assert len(np.unique(expected[0])) > 3
    for count in (2, 4):
        for values, reference in zip(lengths_and_returns(devices(count)), expected, strict=True):
            np.testing.assert_array_equal(values, reference)


def test_a_state_saved_from_many_devices_continues_on_one(alone: Ailsrs, tmp_path: Path) -> None:
    many = dataclasses.replace(alone, devices=devices(4))
    state, _ = jax.jit(many.update)(jax.jit(many.init)(jax.random.key(0)))
    assert not state.memory.steps.sharding.is_fully_replicated
    with Checkpoints(tmp_path, 1) as checkpoints:
        checkpoints.save(1, state)
    with Checkpoints(tmp_path, 1) as checkpoints:
        moved = checkpoints.restore(jax.jit(alone.init)(jax.random.key(0))).state
    after, _ = jax.jit(alone.update)(moved)
    expected, _ = jax.jit(many.update)(state)
    np.testing.assert_allclose(after.weights, expected.weights, rtol=1e-3, atol=1e-5)


def test_the_compiled_update_takes_its_own_result(alone: Ailsrs) -> None:
    """So nothing is compiled again, whose arguments would lie elsewhere on the devices."""
    many = dataclasses.replace(alone, devices=devices(2))
    state = jax.jit(jax.vmap(many.init))(jax.random.split(jax.random.key(0), 2))
    update = jax.jit(jax.vmap(many.update)).lower(state).compile()
    for _ in range(3):
        state, _ = update(state)
    assert state.iteration.tolist() == [3, 3]


def test_only_returns_lengths_moments_and_gradients_cross() -> None:
    """No trajectory, no direction and no remembered step: read off the compiled program."""
    many = make_ailsrs(WidePointMass(), wide_demonstrations(), SETTINGS, devices(2))
    state = jax.jit(many.init)(jax.random.key(0))
    program = jax.jit(many.update).lower(state).compile().as_text()
    crossing = re.findall(r"= \(?(.*?)\)? (all-\w+|collective-\w+|reduce-scatter)\(", program)
    kinds = {kind for _, kind in crossing}
    assert kinds == {"all-reduce", "all-gather"}
    shapes = {
        (kind, tuple(map(int, filter(None, sizes.split(",")))))
        for result, kind in crossing
        for sizes in re.findall(r"\w+\[([\d,]*)\]", result)
    }
    n, p = WIDE_OBSERVATION, WIDE_ACTION
    gradients = {(n + p, 100), (100, 100), (100, 1), (100,), (1,)}
    moments, scalars = {(), (n,)}, {()}
    for kind, shape in shapes:
        if kind == "all-gather":
            assert math.prod(shape) == 2 * SETTINGS.num_directions, shape
        else:
            assert shape in gradients | moments | scalars, shape
    assert ("all-reduce", (100, 100)) in shapes


def test_random_search_on_the_environments_reward(point_mass: PointMass) -> None:
    settings = ArsSettings(
        num_iterations=3, num_directions=8, noise_std=0.1, episode_length=EPISODE_LENGTH
    )
    results = [
        jax.jit(Ars(point_mass, settings, where).train)(jax.random.key(0))
        for where in (Devices(), devices(4))
    ]
    (state, metrics), (many_state, many_metrics) = results
    np.testing.assert_allclose(many_state.weights, state.weights, rtol=1e-3, atol=1e-5)
    np.testing.assert_array_equal(many_metrics["env_steps"], metrics["env_steps"])
    np.testing.assert_allclose(many_state.statistics.std, state.statistics.std, rtol=1e-4)


def test_directions_must_be_shared_evenly(
    point_mass: PointMass, point_mass_expert: Demonstrations
) -> None:
    settings = dataclasses.replace(SETTINGS, num_directions=6)
    with pytest.raises(UserError, match="6 directions cannot be shared evenly by 4 devices"):
        make_ailsrs(point_mass, point_mass_expert, settings, devices(4))
