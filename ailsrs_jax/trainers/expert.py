"""The expert as imitation learners use it: their view of steps, and the distance to its own."""

import jax
import jax.numpy as jnp
from flax import struct

from ailsrs_jax.components import normalizer
from ailsrs_jax.components.energy_distance import energy_distance, mean_distance
from ailsrs_jax.components.normalizer import RunningStatistics
from ailsrs_jax.data.demonstrations import Demonstrations
from ailsrs_jax.errors import UserError


class Expert(struct.PyTreeNode):
    """Demonstrations, prepared by :func:`make_expert`."""

    inputs: jax.Array  # (E, T, n + p) discriminator inputs
    lengths: jax.Array  # (E,) int32
    statistics: RunningStatistics  # of the expert's observations, the fixed scale of the inputs
    distance_features: jax.Array  # (m, n + p + 1), drawn once
    distance_spread: jax.Array  # () mean distance among them
    stride: int = struct.field(pytree_node=False)  # environment steps between inputs

    def discriminator_inputs(self, observations: jax.Array, actions: jax.Array) -> jax.Array:
        """See :func:`discriminator_inputs`."""
        return discriminator_inputs(self.statistics, observations, actions)

    def distance(
        self, key: jax.Array, inputs: jax.Array, lengths: jax.Array, episode_length: int
    ) -> jax.Array:
        """Energy distance of episodes of at most ``episode_length`` steps to the expert's.

        Args:
            key: of the draws.
            inputs: ``(E, T, n + p)`` discriminator inputs of the episodes.
            lengths: ``(E,)``.
            episode_length: their time limit.
        """
        horizon = self.stride * distance_horizon(self.inputs, self.stride, episode_length)
        num_samples = len(self.distance_features)
        features = distance_features(key, inputs, lengths, horizon, num_samples)
        return energy_distance(features, self.distance_features, self.distance_spread)


def make_expert(
    demonstrations: Demonstrations, episode_length: int, num_distance_samples: int
) -> Expert:
    """Prepare ``demonstrations`` for episodes of at most ``episode_length`` steps.

    Raises:
        UserError: they hold no actions, or subsampling left none of so short an episode.
    """
    if demonstrations.actions is None:
        raise UserError("the demonstrations hold no actions, which the discriminator compares")
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
    inputs = discriminator_inputs(statistics, observations, actions)
    stride = demonstrations.stride
    horizon = distance_horizon(inputs, stride, episode_length)
    if horizon < 1:
        raise UserError(
            f"of the demonstrations only every {stride}th step is kept: episode_length must be at "
            f"least that, not {episode_length}"
        )
    features = distance_features(jax.random.key(0), inputs, lengths, horizon, num_distance_samples)
    spread = mean_distance(features, features)
    return Expert(inputs, lengths, statistics, features, spread, stride)


def distance_horizon(expert_inputs: jax.Array, stride: int, episode_length: int) -> int:
    """How many of the expert's inputs are compared, each with ``stride`` steps of the policy.

    Subsampled from a random offset, an input is that of a moment drawn uniformly from ``stride``
    steps; so, of whole blocks of them, as many moments of an episode are seen alive, and at the
    same times, as of one that is not subsampled.
    """
    # Beyond the demonstrations' own time limit nobody knows what the expert would have done.
    return min(episode_length // stride, expert_inputs.shape[1])


def discriminator_inputs(
    expert_statistics: RunningStatistics, observations: jax.Array, actions: jax.Array
) -> jax.Array:
    """``(..., n + p)``: observations in units of the expert's standard deviation, and actions.

    The scale is fixed, so that the reward does not drift while the policy's statistics move.
    """
    states = (observations - expert_statistics.mean) / expert_statistics.std
    return jnp.concatenate([states, actions], axis=-1)


def distance_features(
    key: jax.Array, inputs: jax.Array, lengths: jax.Array, horizon: int, num_samples: int
) -> jax.Array:
    """Draw ``(m, n + p + 1)`` points for the energy distance from the episodes' ``inputs``.

    Moments are drawn from the first ``horizon`` steps. After an episode's end the state is an
    absorbing one, all zeros but for the last entry, which puts it as far from the others as they
    are from one another; so episodes of another length than the expert's are seen to be different.
    """
    episode_key, time_key = jax.random.split(key)
    episode = jax.random.randint(episode_key, (num_samples,), 0, lengths.shape[0])
    time = jax.random.randint(time_key, (num_samples,), 0, horizon)
    alive = (time < lengths[episode])[:, None]
    points = jnp.where(alive, inputs[episode, time], 0.0)
    absorbed = jnp.where(alive, 0.0, jnp.sqrt(inputs.shape[-1]))
    return jnp.concatenate([points, absorbed], axis=-1)
