"""Many devices give what one gives: episodes bit for bit, and sums up to rounding."""

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
from ailsrs_jax.runs.storage.checkpoint import Checkpoints
from ailsrs_jax.trainers.ailsrs import Ailsrs, make_ailsrs
from ailsrs_jax.trainers.ars import ArsSettings, make_ars
from ailsrs_jax.trainers.parts.ailsrs_settings import AilsrsSettings
from ailsrs_jax.trainers.parts.rollout import Simulator
from ailsrs_jax.trainers.parts.sharing import AXIS
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
    num_distance_samples=90,
)


def on_devices(env: PointMass, count: int) -> Simulator:
    return Simulator(env, Mesh(np.array(jax.devices()[:count]), (AXIS,)))


def moved(trainer: Ailsrs, count: int) -> Ailsrs:
    return dataclasses.replace(trainer, simulator=on_devices(trainer.env, count))


@pytest.fixture
def alone(point_mass: PointMass, point_mass_expert: Demonstrations) -> Ailsrs:
    return make_ailsrs(point_mass, point_mass_expert, SETTINGS)


# Twenty episodes: five for each device, or seven with a copy of the last.
@pytest.mark.slow
@pytest.mark.parametrize("count", [3, 4])
def test_a_run_on_many_devices(alone: Ailsrs, count: int) -> None:
    """Three iterations of two seeds, as the command line runs them."""
    seeds = jnp.array([0, 3])
    results = [
        jax.jit(
            jax.vmap(lambda seed, t=trainer: t.train(jax.random.key(seed))),
            out_shardings=trainer.simulator.everywhere,
        )(seeds)
        for trainer in (alone, moved(alone, count))
    ]
    (state, metrics), (many_state, many_metrics) = results
    for name, values in metrics.items():
        np.testing.assert_allclose(many_metrics[name], values, rtol=2e-3, atol=1e-4, err_msg=name)
    np.testing.assert_array_equal(many_metrics["env_steps"], metrics["env_steps"])
    np.testing.assert_allclose(many_state.weights, state.weights, rtol=1e-3, atol=1e-4)
    np.testing.assert_array_equal(many_state.memory.lengths, state.memory.lengths)
    np.testing.assert_allclose(many_state.memory.steps, state.memory.steps, atol=1e-3)
    assert float(jnp.abs(state.weights).max()) > 0.1  # they went somewhere


@pytest.mark.parametrize("count", [2, 3, 4])
def test_episodes_are_the_same_bits(point_mass: PointMass, alone: Ailsrs, count: int) -> None:
    state = alone.init(jax.random.key(0))
    weights = jax.random.normal(jax.random.key(1), (16, *state.weights.shape))
    policies = jax.vmap(lambda w: alone.space.policy(w, state.hidden, state.statistics))(weights)
    keys = jax.random.split(jax.random.key(2), 16)
    expected, episodes = (
        jax.jit(lambda s=simulator: s(policies, keys, EPISODE_LENGTH))()
        for simulator in (Simulator(point_mass), on_devices(point_mass, count))
    )
    assert len(np.unique(expected.lengths)) > 3
    for name in ("observations", "actions", "env_rewards", "lengths", "diverged"):
        np.testing.assert_array_equal(getattr(episodes, name), getattr(expected, name))


@pytest.mark.slow
def test_a_state_saved_from_many_devices_continues_on_one(alone: Ailsrs, tmp_path: Path) -> None:
    many = moved(alone, 4)
    place = many.simulator.everywhere
    update = jax.jit(many.update, out_shardings=place)
    state, _ = update(jax.jit(many.init, out_shardings=place)(jax.random.key(0)))
    with Checkpoints(tmp_path, 1) as checkpoints:
        checkpoints.save(1, state)
    with Checkpoints(tmp_path, 1) as checkpoints:
        restored = checkpoints.restore(jax.jit(alone.init)(jax.random.key(0))).state
    after, _ = jax.jit(alone.update)(restored)
    expected, _ = update(state)
    np.testing.assert_allclose(after.weights, expected.weights, rtol=1e-3, atol=1e-5)


def test_the_compiled_update_takes_its_own_result(alone: Ailsrs) -> None:
    """So nothing is compiled again for arguments that lie elsewhere on the devices."""
    many = moved(alone, 2)
    place = many.simulator.everywhere
    keys = jax.random.split(jax.random.key(0), 2)
    state = jax.jit(jax.vmap(many.init), out_shardings=place)(keys)
    update = jax.jit(jax.vmap(many.update), out_shardings=place).lower(state).compile()
    for _ in range(3):
        state, _ = update(state)
    assert state.iteration.tolist() == [3, 3]


def test_no_trajectory_crosses() -> None:
    """Only evaluation episodes, sampled steps, returns and moments do: see the compiled program."""
    env = WidePointMass()
    many = make_ailsrs(on_devices(env, 2), wide_demonstrations(), SETTINGS)
    place = many.simulator.everywhere
    state = jax.jit(many.init, out_shardings=place)(jax.random.key(0))
    program = jax.jit(many.update, out_shardings=place).lower(state).compile().as_text()
    crossing = re.findall(r"= \(?(.*?)\)? (all-\w+|collective-\w+|reduce-scatter)\(", program)
    sizes = [
        math.prod(map(int, filter(None, shape.split(","))))
        for result, _ in crossing
        for shape in re.findall(r"\w+\[([\d,]*)\]", result)
    ]
    width = WIDE_OBSERVATION + WIDE_ACTION
    evaluation = SETTINGS.num_evaluation_episodes * EPISODE_LENGTH * WIDE_OBSERVATION
    sampled = (SETTINGS.memory_samples + 10 * SETTINGS.num_evaluation_episodes) * width
    assert max(sizes) <= max(evaluation, sampled)
    # The discriminator's gradients do not: it is trained everywhere.
    assert width * 100 not in sizes


def test_random_search_on_the_environments_reward(point_mass: PointMass) -> None:
    settings = ArsSettings(
        num_iterations=3, num_directions=8, noise_std=0.1, episode_length=EPISODE_LENGTH
    )
    results = [
        jax.jit(make_ars(simulator, settings).train)(jax.random.key(0))
        for simulator in (Simulator(point_mass), on_devices(point_mass, 4))
    ]
    (state, metrics), (many_state, many_metrics) = results
    np.testing.assert_allclose(many_state.weights, state.weights, rtol=1e-3, atol=1e-5)
    np.testing.assert_array_equal(many_metrics["env_steps"], metrics["env_steps"])
    np.testing.assert_allclose(many_state.statistics.std, state.statistics.std, rtol=1e-4)
