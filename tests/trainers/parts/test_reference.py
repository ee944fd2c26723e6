"""The expert's view of steps, and the energy distance of episodes to its own."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ailsrs_jax.data.demonstrations import Demonstrations
from ailsrs_jax.errors import UserError
from ailsrs_jax.trainers.parts.episodes import Episodes
from ailsrs_jax.trainers.parts.reference import make_reference, unlike_the_others

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


@pytest.mark.parametrize("time_limit", [TIME_LIMIT, 80])
@pytest.mark.parametrize("every", [1, 5, 7, 33])
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
