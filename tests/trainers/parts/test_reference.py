"""The expert's view of steps, the energy distance of episodes to its own, and starts from it."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ailsrs_jax.data.demonstrations import Demonstrations
from ailsrs_jax.envs.registry import TASKS, make_env
from ailsrs_jax.errors import UserError
from ailsrs_jax.trainers.parts.episodes import Episodes
from ailsrs_jax.trainers.parts.reference import Reference, make_reference, unlike_the_others

TIME_LIMIT = 100
NUM_SAMPLES = 2000


def episodes(num_episodes: int, seed: int) -> Demonstrations:
    """Noisy ramps; every other one falls after about 60 steps."""
    rng = np.random.default_rng(seed)
    time = np.arange(TIME_LIMIT) / TIME_LIMIT
    observations = np.stack([time, time**2], axis=-1) + rng.normal(
        scale=0.05, size=(num_episodes, TIME_LIMIT, 2)
    )
    lengths = np.where(np.arange(num_episodes) % 2, TIME_LIMIT, rng.integers(50, 70, num_episodes))
    return Demonstrations(
        observations=observations.astype(np.float32),
        actions=np.cos(6 * observations[..., :1]).astype(np.float32),
        lengths=lengths,
        returns=np.zeros(num_episodes, np.float32),
        env_id="Ramp",
    )


def distance(demonstrations: Demonstrations, policy: Demonstrations, time_limit: int) -> float:
    expert = make_reference(demonstrations, time_limit, NUM_SAMPLES)
    observations, actions = (
        jnp.asarray(x[:, :time_limit]) for x in (policy.observations, policy.actions)
    )
    lengths = jnp.minimum(policy.lengths, time_limit)
    rewards = jnp.zeros(actions.shape[:2])
    episodes = Episodes(
        observations,
        actions,
        rewards,
        lengths,
        diverged=jnp.zeros(lengths.shape, bool),
        final_observations=observations[:, -1],
        slot_steps=lengths.sum(),
    )
    return float(expert.distance(jax.random.key(1), episodes, time_limit))


@pytest.mark.parametrize(("every", "time_limit"), [(1, 80), (5, 100), (7, 80), (33, 100)])
def test_subsampled_demonstrations_are_as_far_away(every: int, time_limit: int) -> None:
    every_step, policy = episodes(400, seed=0), episodes(400, seed=1)
    demonstrations = every_step.subsample(every)
    assert abs(distance(demonstrations, policy, time_limit)) < 0.02
    shorter = policy.replace(lengths=policy.lengths // 2)
    far = distance(every_step, shorter, time_limit)
    assert far > 0.4
    assert distance(demonstrations, shorter, time_limit) == pytest.approx(far, rel=0.25)


def test_states_alone_are_compared_where_actions_are_not_known() -> None:
    every_step, policy = episodes(400, seed=0), episodes(400, seed=1)
    demonstrations = every_step.replace(actions=None)
    assert abs(distance(demonstrations, policy, TIME_LIMIT)) < 0.02
    other_actions = policy.replace(actions=policy.actions + 1.0)
    same = distance(demonstrations, policy, TIME_LIMIT)
    assert distance(demonstrations, other_actions, TIME_LIMIT) == same
    assert distance(every_step, other_actions, TIME_LIMIT) > 0.35


def test_demonstrations_that_cannot_be_compared() -> None:
    demonstrations = episodes(4, seed=0)
    with pytest.raises(UserError, match=r"every 20th step .* is 10, it must be at least 20"):
        make_reference(demonstrations.subsample(20), 10, 10)
    with pytest.raises(UserError, match=r"is 0.5: no demonstration is left; make it at least 1"):
        make_reference(demonstrations, TIME_LIMIT, 10, leave_out_beyond=0.5)


def test_short_episodes_are_not_compared_with_falls() -> None:
    demonstrations = episodes(4, seed=0)
    short = np.minimum(demonstrations.lengths, TIME_LIMIT // 2)
    falls = make_reference(demonstrations.replace(lengths=short), TIME_LIMIT, 10)
    falls.require_comparable(TIME_LIMIT, TIME_LIMIT)
    with pytest.raises(UserError, match="would reward early ends in episodes of 20 steps"):
        falls.require_comparable(20, TIME_LIMIT)
    full = np.full(4, TIME_LIMIT)
    make_reference(demonstrations.replace(lengths=full), TIME_LIMIT, 10).require_comparable(20, 40)
    rare = make_reference(demonstrations.subsample(20), TIME_LIMIT, 10)
    with pytest.raises(UserError, match=r"search_length is 10, energy_share needs at least 20"):
        rare.require_comparable(10, TIME_LIMIT)


def test_demonstrations_that_are_unlike_most_are_left_out(caplog: pytest.LogCaptureFixture) -> None:
    demonstrations = episodes(20, seed=0)
    observations = np.array(demonstrations.observations)
    observations[3] += 3.0
    changed = demonstrations.replace(observations=observations)
    reference = make_reference(changed, TIME_LIMIT, NUM_SAMPLES)
    assert np.flatnonzero(unlike_the_others(reference, TIME_LIMIT, 5.0)).tolist() == [3]
    typical = make_reference(changed, TIME_LIMIT, NUM_SAMPLES, leave_out_beyond=5.0)
    assert len(typical.lengths) == 19
    assert "unlike most: 3" in caplog.text
    others = np.delete(demonstrations.observations, 3, axis=0)
    np.testing.assert_allclose(
        typical.unstandardize(typical.observations)[typical.alive],
        others[np.delete(demonstrations.alive, 3, axis=0)],
        atol=1e-5,
    )
    assert len(make_reference(changed, TIME_LIMIT, NUM_SAMPLES).lengths) == 20


def test_of_equal_demonstrations_none_is_left_out() -> None:
    one = episodes(1, seed=0)
    same = one.replace(
        observations=np.repeat(one.observations, 4, axis=0) * 0.0,
        actions=np.repeat(one.actions, 4, axis=0) * 0.0,
        lengths=np.repeat(one.lengths, 4),
        returns=np.zeros(4, np.float32),
    )
    reference = make_reference(same, TIME_LIMIT, NUM_SAMPLES, leave_out_beyond=5.0)
    assert len(reference.lengths) == 4


def reference_of(observations: np.ndarray, lengths: list[int]) -> Reference:
    num_episodes, num_steps, _ = observations.shape
    demonstrations = Demonstrations(
        observations=observations.astype(np.float32),
        actions=np.zeros((num_episodes, num_steps, 1), np.float32),
        lengths=np.array(lengths),
        returns=np.zeros(num_episodes, np.float32),
        env_id="noise",
    )
    return make_reference(demonstrations, num_steps, 10)


@pytest.mark.parametrize("env_id", TASKS)
def test_the_state_of_an_observation_makes_it_again(env_id: str) -> None:
    env = make_env(env_id, "mujoco")
    state, step = jax.jit(env.reset)(jax.random.key(0)), jax.jit(env.step)
    for action in jax.random.uniform(jax.random.key(1), (3, env.action_size), minval=-0.3):
        state = step(state, action)
    num_numbers = env.physics.model.nq + env.physics.model.nv - env._num_hidden_positions
    again = jax.jit(lambda observation: env.start(env.state_at(observation)))(state.obs)
    # Forces and velocities of bodies are those of the last step, which a start does not have.
    np.testing.assert_allclose(again.obs[:num_numbers], state.obs[:num_numbers], atol=1e-6)


def test_starts_are_resets_and_demonstrated_states_in_the_share_asked_for() -> None:
    env = make_env("swimmer", "mujoco")
    observations = 10.0 + np.arange(2 * 3 * 8).reshape(2, 3, 8)
    reference = reference_of(observations, [3, 2])
    draw = jax.jit(reference.draw_starts, static_argnums=(0, 2))
    counts, angles = [], set()
    for seed in range(40):
        starts = draw(env, jax.random.key(seed), 5, jnp.float32(0.5))
        demonstrated = np.asarray(starts.qpos[:, 2]) > 5.0  # resets are close to zero
        counts.append(int(demonstrated.sum()))
        angles |= set(np.asarray(starts.qpos[demonstrated, 2]).round(2).tolist())
        np.testing.assert_array_equal(starts.qpos[demonstrated, :2], 0.0)
    assert set(counts) == {2, 3}
    np.testing.assert_allclose(np.mean(counts), 2.5, atol=0.3)
    # Any live step is drawn, and no other.
    assert angles == {10.0, 18.0, 26.0, 34.0, 42.0}


def test_without_a_share_there_are_only_resets() -> None:
    env = make_env("swimmer", "mujoco")
    reference = reference_of(np.ones((1, 2, 8)), [2])
    keys = reference.draw_starts(env, jax.random.key(0), 3, 0.0)
    np.testing.assert_array_equal(
        jax.random.key_data(keys).shape, jax.random.key_data(jax.random.split(keys[0], 3)).shape
    )


def test_an_environment_that_cannot_be_put_into_a_state_is_reset(point_mass: object) -> None:
    reference = reference_of(np.ones((1, 2, 2)), [2])
    starts = reference.draw_starts(point_mass, jax.random.key(0), 3, 0.5)
    assert jnp.issubdtype(starts.dtype, jax.dtypes.prng_key)


def test_a_task_that_makes_its_observation_otherwise_is_reset() -> None:
    class Doubled(type(make_env("swimmer", "mujoco"))):  # type: ignore[misc]
        def _observation(self, physics_state):
            return 2.0 * super()._observation(physics_state)

    reference = reference_of(np.ones((1, 2, 8)), [2])
    starts = reference.draw_starts(Doubled(physics="mujoco"), jax.random.key(0), 3, 0.5)
    assert jnp.issubdtype(starts.dtype, jax.dtypes.prng_key)


def test_it_can_be_judged_in_a_trace_of_the_program() -> None:
    """As a sweep does, which checks each cell without computing anything."""

    def check() -> None:
        reference_of(np.ones((1, 4, 2)), [4]).require_comparable(2, 4)

    jax.eval_shape(check)
