import jax
import jax.numpy as jnp
import numpy as np
import pytest
from brax.envs.wrappers.training import EpisodeWrapper

from ailsrs_jax.components.policy import LinearPolicy
from ailsrs_jax.envs.interface import action_range, starts_at_observations
from ailsrs_jax.envs.registry import make_env
from ailsrs_jax.trainers.parts.episodes import Episodes
from ailsrs_jax.trainers.parts.rollout import merge_vmapped_axis, simulate
from tests.point_mass import PointMass


def constant_force(forces: jax.Array) -> LinearPolicy:
    """A batch of policies that push with a constant force: the mean is far from any state."""
    number = len(forces)
    ones = jnp.ones((number, 1))
    return LinearPolicy(
        weights=-forces[:, None, None] * jnp.array([1e-6, 0.0]),
        mean=jnp.full((number, 2), 1e6),
        std=jnp.ones((number, 2)),
        action_low=-ones,
        action_high=ones,
    )


@pytest.mark.parametrize("limit", [10, 60])
def test_against_a_plain_loop(limit: int, point_mass: PointMass) -> None:
    forces, keys = jnp.array([0.0, 1.0, -0.5]), jax.random.split(jax.random.key(3), 3)
    policies = constant_force(forces)
    result = jax.jit(simulate, static_argnums=(0, 3))(point_mass, policies, keys, limit)
    for index in range(3):
        env_state, length, total = point_mass.reset(keys[index]), 0, 0.0
        while length < limit and not env_state.done:
            np.testing.assert_allclose(result.observations[index, length], env_state.obs, atol=1e-4)
            np.testing.assert_allclose(result.actions[index, length], forces[index], atol=1e-5)
            env_state = point_mass.step(env_state, forces[index][None])
            total += float(env_state.reward)
            length += 1
        assert int(result.lengths[index]) == length
        np.testing.assert_allclose(result.env_returns[index], total, rtol=1e-3)
        for buffer in (result.observations, result.actions, result.env_rewards):
            assert not buffer[index, length:].any()
    assert int(result.env_steps) == int(result.lengths.sum())
    np.testing.assert_array_equal(result.usable.sum(axis=1), result.lengths)
    assert (int(result.lengths[1]) == limit) == (limit == 10)  # a push leaves the field after 10


def test_a_wrapper_is_not_bypassed() -> None:
    """It hands on what the task in it has, such as a way to run whole episodes on the C engine."""
    task = make_env("swimmer", "mujoco")
    low, high = action_range(task)
    ones = jnp.ones((2, 8))
    policies = LinearPolicy(
        jnp.zeros((2, 2, 8)), 0 * ones, ones, jnp.stack([low] * 2), jnp.stack([high] * 2)
    )
    keys = jax.random.split(jax.random.key(0), 2)
    for env, lengths in ((task, [5, 5]), (EpisodeWrapper(task, 3, 1), [3, 3])):
        assert simulate(env, policies, keys, 5).lengths.tolist() == lengths
    assert not starts_at_observations(EpisodeWrapper(task, 3, 1))  # its reset would be left out


def test_vmap_is_the_same_as_one_by_one(point_mass: PointMass) -> None:
    forces = jnp.array([[0.0, 1.0], [-1.0, 0.3], [0.5, 0.5]])
    policies = jax.vmap(constant_force)(forces)
    keys = jax.random.split(jax.random.key(0), (3, 2))

    def short(policies: LinearPolicy, keys: jax.Array) -> Episodes:
        return simulate(point_mass, policies, keys, 30)

    together = jax.jit(jax.vmap(short))(policies, keys)
    for index in range(3):
        alone = jax.jit(short)(jax.tree.map(lambda x, i=index: x[i], policies), keys[index])
        for name in ("observations", "actions", "env_rewards", "lengths"):
            mine = getattr(together, name)[index]
            np.testing.assert_allclose(mine, getattr(alone, name), atol=1e-6)


def test_vmap_over_one_argument_only(point_mass: PointMass) -> None:
    policies = constant_force(jnp.array([0.0, 1.0]))
    keys = jax.random.split(jax.random.key(0), (3, 2))
    together = jax.vmap(lambda keys: simulate(point_mass, policies, keys, 5))(keys)
    assert together.observations.shape == (3, 2, 5, 2)
    assert together.lengths.shape == (3, 2)


@pytest.mark.parametrize("batch_size", [1, 3, 8, 16, 39])
def test_slots_are_refilled_and_the_episodes_are_the_same(
    batch_size: int, point_mass: PointMass
) -> None:
    forces = jnp.linspace(-1.0, 1.0, 40)  # some leave the field soon, some late, some never
    policies, keys = constant_force(forces), jax.random.split(jax.random.key(5), 40)
    plain = jax.jit(lambda: simulate(point_mass, policies, keys, 60))()
    packed = jax.jit(lambda: simulate(point_mass, policies, keys, 60, batch_size))()
    assert int(plain.lengths.min()) < 20 < 60 == int(plain.lengths.max())
    assert int(plain.slot_steps) == 40 * 60
    assert int(plain.env_steps) == int(packed.env_steps) <= int(packed.slot_steps)
    utilization = float(packed.env_steps / packed.slot_steps)
    assert utilization > (0.85 if batch_size <= 8 else 0.65)
    np.testing.assert_array_equal(plain.lengths, packed.lengths)
    for name in ("observations", "actions", "env_rewards"):
        # XLA fuses a step of so few simulations otherwise, which can round otherwise.
        np.testing.assert_allclose(
            getattr(plain, name), getattr(packed, name), rtol=1e-5, atol=1e-6
        )


def test_slots_are_shared_by_what_vmap_merges(point_mass: PointMass) -> None:
    policies = jax.vmap(constant_force)(jnp.array([[0.0, 1.0, -1.0], [-0.5, 0.3, 0.9]]))
    keys = jax.random.split(jax.random.key(0), (2, 3))
    plain, packed = (
        jax.vmap(lambda p, k, size=size: simulate(point_mass, p, k, 50, size))(policies, keys)
        for size in (None, 4)
    )
    np.testing.assert_array_equal(plain.observations, packed.observations)
    assert packed.slot_steps.tolist() == [packed.slot_steps[0]] * 2


def test_stops_when_nobody_is_alive(point_mass: PointMass) -> None:
    calls = []

    class Counting(PointMass):
        def step(self, state, action):
            jax.debug.callback(lambda: calls.append(1))
            return super().step(state, action)

    result = simulate(
        Counting(), constant_force(jnp.array([1.0])), jax.random.split(jax.random.key(0), 1), 1000
    )
    jax.block_until_ready(result)
    jax.effects_barrier()
    assert len(calls) == int(result.lengths[0]) < 100


@pytest.mark.slow
def test_both_engines_give_the_same_episodes() -> None:
    env = make_env("swimmer", "mjx")
    low, high = action_range(env)
    weights = 0.5 * jax.random.normal(jax.random.key(0), (4, 2, 8))
    policy = LinearPolicy(weights[0], jnp.zeros(8), jnp.ones(8), low, high)
    keys = jax.random.split(jax.random.key(1), 4)
    result = jax.jit(simulate, static_argnums=(0, 3))(env, policy.with_weights(weights), keys, 50)
    assert result.lengths.tolist() == [50] * 4
    # Measured with the C engine; the swimmer is not chaotic over 50 steps.
    reference = jax.jit(simulate, static_argnums=(0, 3))(
        make_env("swimmer", "mujoco"), policy.with_weights(weights), keys, 50
    )
    np.testing.assert_allclose(result.observations, reference.observations, atol=2e-3)
    np.testing.assert_allclose(result.env_returns, reference.env_returns, atol=0.05)


def test_arrays_that_hold_nothing_are_merged_too() -> None:
    """As states of actuators are in a model that has none."""
    empty = jnp.zeros((2, 3, 0))
    assert jax.vmap(merge_vmapped_axis(lambda x: x))(empty).shape == (2, 3, 0)
