import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ailsrs_jax.components.policy import MlpPolicy
from ailsrs_jax.envs.registry import make_env
from ailsrs_jax.trainers.parts import segments
from tests.point_mass import PointMass


def some_policy(push: float, action_std: float) -> MlpPolicy:
    """Always the same mean."""
    return MlpPolicy(
        weights=(jnp.zeros((4, 2)), jnp.zeros((1, 4))),
        biases=(jnp.zeros(4), jnp.array([push])),
        mean=jnp.zeros(2),
        std=jnp.ones(2),
        action_low=-jnp.ones(1),
        action_high=jnp.ones(1),
        action_std=jnp.array([action_std]),
    )


@pytest.mark.parametrize("push", [0.0, 1.0])  # the second leaves the range within 25 steps
def test_episodes_follow_one_another(push: float, point_mass: PointMass) -> None:
    limit = 30
    episodes = segments.begin(point_mass, jax.random.key(0), 3)
    pieces = []
    for key in jax.random.split(jax.random.key(1), 2):
        policy = some_policy(push, 0.1)
        episodes, steps = segments.collect(point_mass, policy, episodes, key, 40, limit)
        pieces.append(steps)
    steps = jax.tree.map(lambda *x: jnp.concatenate(x), *pieces)

    over, following = np.asarray(steps.over), np.asarray(steps.next_observations)
    # Within an episode, over the batches' border too, states follow one another,
    same = ~over[:-1]
    np.testing.assert_array_equal(following[:-1][same], steps.observations[1:][same])
    # a new one begins where Brax's reset puts it,
    assert (np.abs(np.asarray(steps.observations[1:])[over[:-1]]) <= 1.0).all()
    # and none is longer than the limit.
    for env in range(3):
        ends = np.flatnonzero(over[:, env])
        lengths = np.diff(ends, prepend=-1)
        assert (lengths <= limit).all()
        outside = np.abs(following[ends, env, 0]) > 3
        np.testing.assert_array_equal(np.asarray(steps.terminated)[ends, env], outside)
        np.testing.assert_array_equal(lengths[~outside], limit)
    np.testing.assert_array_equal(np.clip(steps.drawn_actions, -1, 1), steps.actions)
    np.testing.assert_allclose(steps.env_rewards, -np.square(following[..., 0]), rtol=1e-5)


def test_actions_are_drawn_from_the_gaussian(point_mass: PointMass) -> None:
    episodes = segments.begin(point_mass, jax.random.key(0), 50)
    policy = some_policy(0.3, 0.2)
    _, steps = segments.collect(point_mass, policy, episodes, jax.random.key(1), 100, 1000)
    np.testing.assert_allclose(steps.drawn_actions.mean(), 0.3, atol=0.01)
    np.testing.assert_allclose(steps.drawn_actions.std(), 0.2, atol=0.01)


@pytest.mark.slow
def test_seeds_beside_one_another_are_those_alone() -> None:
    """On the C engine, whose environments of several seeds share a call."""
    env = make_env("hopper", "mujoco")
    policy = some_policy(0.0, 0.5).replace(
        weights=(jnp.zeros((4, 11)), jnp.zeros((3, 4))),
        biases=(jnp.zeros(4), jnp.array([0.5, -0.5, 0.5])),
        mean=jnp.zeros(11),
        std=jnp.ones(11),
        **{name: jnp.full(3, x) for name, x in (("action_low", -1.0), ("action_high", 1.0))},
        action_std=jnp.full(3, 0.5),
    )

    def run(seed: jax.Array) -> segments.Steps:
        reset_key, key = jax.random.split(jax.random.key(seed))
        episodes = segments.begin(env, reset_key, 2)
        return segments.collect(env, policy, episodes, key, 40, 1000)[1]

    together = jax.jit(jax.vmap(run))(jnp.arange(2))
    assert together.over.any()
    for seed in range(2):
        alone = jax.jit(run)(seed)
        jax.tree.map(
            lambda many, one, seed=seed: np.testing.assert_array_equal(many[seed], one),
            together,
            alone,
        )


def test_nothing_is_reset_while_no_episode_is_over() -> None:
    """Beside other seeds too, where each branch of a condition would be computed."""
    resets = []

    class Counting(PointMass):
        def reset(self, rng):
            jax.debug.callback(lambda: resets.append(1))
            return super().reset(rng)

    env = Counting()

    def run(seed: jax.Array) -> segments.Steps:
        key = jax.random.key(seed)
        return segments.collect(
            env, some_policy(0.0, 0.0), segments.begin(env, key, 3), key, 25, 10
        )[1]

    steps = jax.jit(jax.vmap(run))(jnp.arange(2))
    jax.block_until_ready(steps)
    jax.effects_barrier()
    assert np.flatnonzero(np.asarray(steps.over).any(axis=(0, 2))).tolist() == [9, 19]
    assert len(resets) == 3  # of all environments: at first, and after each end
