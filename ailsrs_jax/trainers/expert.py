"""The expert as imitation learners use it: its steps, and the distance of others' to them."""

import jax
import jax.numpy as jnp
from flax import struct

from ailsrs_jax.components import normalizer
from ailsrs_jax.components.energy_distance import energy_distance, mean_distance
from ailsrs_jax.components.normalizer import RunningStatistics
from ailsrs_jax.data.demonstrations import Demonstrations


class Expert(struct.PyTreeNode):
    """Demonstrations, prepared by :func:`make_expert`."""

    observations: jax.Array  # (E, T, n) in units of the expert's standard deviation
    actions: jax.Array  # (E, T, p)
    lengths: jax.Array  # (E,) int32
    statistics: RunningStatistics  # of the expert's observations
    distance_features: jax.Array  # (m, n + p + 1), drawn once
    distance_spread: jax.Array  # () mean distance among them

    @property
    def alive(self) -> jax.Array:
        """``(E, T)`` bool: the step happened."""
        return jnp.arange(self.observations.shape[1]) < self.lengths[:, None]

    def standardize(self, observations: jax.Array) -> jax.Array:
        """Observations ``(..., n)`` in units of the expert's standard deviation.

        The scale is fixed, so that a reward made of it does not drift while the policy's own
        statistics move.
        """
        return standardize(self.statistics, observations)

    def distance(
        self,
        key: jax.Array,
        observations: jax.Array,
        actions: jax.Array,
        lengths: jax.Array,
        episode_length: int,
    ) -> jax.Array:
        """Energy distance of episodes of at most ``episode_length`` steps to the expert's.

        Args:
            key: of the draws.
            observations: ``(E, T, n)`` of the episodes.
            actions: ``(E, T, p)``.
            lengths: ``(E,)``.
            episode_length: their time limit.
        """
        horizon = distance_horizon(self.observations, episode_length)
        num_samples = len(self.distance_features)
        points = jnp.concatenate([self.standardize(observations), actions], axis=-1)
        features = distance_features(key, points, lengths, horizon, num_samples)
        return energy_distance(features, self.distance_features, self.distance_spread)


def make_expert(
    demonstrations: Demonstrations, episode_length: int, num_distance_samples: int
) -> Expert:
    """Prepare ``demonstrations`` for episodes of at most ``episode_length`` steps."""
    observations, actions, lengths, alive = map(
        jnp.asarray,
        (
            demonstrations.observations,
            demonstrations.actions,
            demonstrations.lengths,
            demonstrations.alive,
        ),
    )
    statistics = normalizer.update(normalizer.init(observations.shape[-1]), observations, alive)
    observations = standardize(statistics, observations)
    points = jnp.concatenate([observations, actions], axis=-1)
    horizon = distance_horizon(points, episode_length)
    features = distance_features(jax.random.key(0), points, lengths, horizon, num_distance_samples)
    spread = mean_distance(features, features)
    return Expert(observations, actions, lengths, statistics, features, spread)


def standardize(statistics: RunningStatistics, observations: jax.Array) -> jax.Array:
    """Observations ``(..., n)`` in units of the standard deviation."""
    return (observations - statistics.mean) / statistics.std


def distance_horizon(expert_steps: jax.Array, episode_length: int) -> int:
    """Steps of an episode that are compared."""
    # Beyond the demonstrations' own time limit nobody knows what the expert would have done.
    return min(episode_length, expert_steps.shape[1])


def distance_features(
    key: jax.Array, points: jax.Array, lengths: jax.Array, horizon: int, num_samples: int
) -> jax.Array:
    """Draw ``(m, d + 1)`` for the energy distance from the ``points (E, T, d)`` of episodes.

    Moments are drawn from the first ``horizon`` steps. After an episode's end the state is an
    absorbing one, all zeros but for the last entry, which puts it as far from the others as they
    are from one another; so episodes of another length than the expert's are seen to be different.
    """
    episode_key, time_key = jax.random.split(key)
    episode = jax.random.randint(episode_key, (num_samples,), 0, lengths.shape[0])
    time = jax.random.randint(time_key, (num_samples,), 0, horizon)
    alive = (time < lengths[episode])[:, None]
    drawn = jnp.where(alive, points[episode, time], 0.0)
    absorbed = jnp.where(alive, 0.0, jnp.sqrt(points.shape[-1]))
    return jnp.concatenate([drawn, absorbed], axis=-1)
