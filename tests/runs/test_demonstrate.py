"""Recordings of a policy, with noise and with the final observations."""

import jax
import numpy as np
import pytest

from ailsrs_jax.data.policies import SavedPolicy, expert_path, load_policy
from ailsrs_jax.envs.registry import make_env
from ailsrs_jax.errors import UserError
from ailsrs_jax.runs.demonstrate import record, roll_out
from tests.point_mass import TIME_STEP, PointMass, linear_policy


def pushes(weights: list[float]) -> SavedPolicy:
    return linear_policy(np.array([weights]))


def one_step(observation: np.ndarray, action: np.ndarray) -> np.ndarray:
    position, velocity = observation
    velocity = velocity + TIME_STEP * action[0]
    return np.array([position + TIME_STEP * velocity, velocity])


def test_noise_is_recorded_as_applied() -> None:
    policy, env = pushes([-0.1, -0.1]), PointMass()
    plain, noisy, more = (
        record(policy, number, env=env, episode_length=500, action_noise=noise).demonstrations
        for number, noise in ((2, 0.0), (2, 0.2), (3, 0.2))
    )
    np.testing.assert_array_equal(noisy.actions, more.actions[:2])
    np.testing.assert_array_equal(noisy.observations[:, 0], plain.observations[:, 0])
    alive = np.asarray(noisy.alive)
    added = noisy.actions[alive][:, 0] - noisy.observations[alive] @ [-0.1, -0.1]
    np.testing.assert_allclose(added.mean(), 0.0, atol=0.03)
    np.testing.assert_allclose(added.std(), 0.2, rtol=0.1)
    with pytest.raises(UserError, match="action_noise is -1"):
        record(policy, 1, env=env, action_noise=-1.0)


@pytest.mark.parametrize(("weights", "falls"), [([-0.4, -0.6], False), ([5.0, 5.0], True)])
def test_the_last_action_leads_to_the_final_observation(weights: list[float], falls: bool) -> None:
    policy, env = pushes(weights), PointMass()
    recording = record(policy, 4, env=env, episode_length=60)
    demonstrations = recording.demonstrations
    plain = roll_out(policy, env, 4, jax.random.key(0), 60)
    np.testing.assert_array_equal(demonstrations.lengths, plain.lengths)
    assert (demonstrations.lengths < 60).all() == falls
    for ours, theirs in (
        (demonstrations.observations, plain.observations),
        (demonstrations.actions, plain.actions),
        (demonstrations.returns, plain.env_returns),
        (recording.env_rewards, plain.env_rewards),
    ):
        np.testing.assert_allclose(ours, theirs, rtol=1e-5, atol=1e-6)
    for index, length in enumerate(demonstrations.lengths):
        last = demonstrations.observations[index, length - 1]
        expected = one_step(last, demonstrations.actions[index, length - 1])
        np.testing.assert_allclose(recording.final_observations[index], expected, rtol=1e-5)
        assert (abs(recording.final_observations[index, 0]) > 3) == falls


def test_an_episode_that_ends_with_the_time_limit() -> None:
    lengths = record(pushes([5.0, 5.0]), 4, env=PointMass(), episode_length=60).demonstrations
    limit = int(lengths.lengths.max())
    recording = record(pushes([5.0, 5.0]), 4, env=PointMass(), episode_length=limit)
    np.testing.assert_array_equal(recording.demonstrations.lengths, lengths.lengths)
    assert (abs(recording.final_observations[:, 0]) > 3).all()


def test_the_c_engine_gives_the_same_episodes_bit_for_bit() -> None:
    policy = load_policy(expert_path("Swimmer-v5"))
    env = make_env("swimmer", "mujoco")
    demonstrations = record(policy, 2, env=env, episode_length=50).demonstrations
    plain = roll_out(policy, env, 2, jax.random.key(0), 50)
    np.testing.assert_array_equal(demonstrations.observations, plain.observations)
    np.testing.assert_array_equal(demonstrations.actions, plain.actions)
