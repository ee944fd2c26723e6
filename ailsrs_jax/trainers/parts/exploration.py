"""The episodes of one iteration of random search."""

from typing import Any

import jax
import jax.numpy as jnp
from flax import struct

from ailsrs_jax.components import random_search
from ailsrs_jax.components.policy import LinearPolicy
from ailsrs_jax.trainers.parts.episodes import Episodes
from ailsrs_jax.trainers.parts.rollout import Simulator


class Exploration(struct.PyTreeNode):
    """E episodes of the unperturbed policy, then N of ``M + ν δ_i``, then N of ``M − ν δ_i``.

    They stay in one batch, because a part of it would be a copy.
    """

    episodes: Episodes
    num_evaluations: int = struct.field(pytree_node=False)  # E

    @property
    def evaluation(self) -> Episodes:
        """The episodes of the unperturbed policy."""
        return self.episodes.first(self.num_evaluations)

    def pairs(self, values: jax.Array) -> jax.Array:
        """Return those ``(2, N, ...)`` of ``values (E + 2N, ...)`` for the perturbed policies."""
        return values[self.num_evaluations :].reshape(2, -1, *values.shape[1:])

    @property
    def alive(self) -> jax.Array:
        """``(E + 2N, T)`` bool: a perturbed policy made the step, and it may be learned from."""
        num_episodes, num_steps, _ = self.episodes.observations.shape
        is_search = jnp.arange(num_episodes) >= self.num_evaluations
        lengths = jnp.where(is_search, self.episodes.usable_lengths, 0)
        return jnp.arange(num_steps) < lengths[:, None]


def explore(
    simulator: Simulator,
    policy: LinearPolicy,
    deltas: jax.Array,
    key: jax.Array,
    settings: Any,
) -> Exploration:
    """Simulate the unperturbed policy and, in the same batch, the perturbed ones.

    Args:
        simulator: simulates the episodes.
        policy: the unperturbed policy.
        deltas: ``(N, p, n)`` unit noise.
        key: of the initial states.
        settings: of a random search: ``noise_std`` ν, ``episode_length`` T and
            ``num_evaluation_episodes`` E.
    """
    num_evaluations = settings.num_evaluation_episodes
    perturbed = random_search.perturb(policy.weights, deltas, settings.noise_std)
    unperturbed = jnp.tile(policy.weights, (num_evaluations, 1, 1))
    episodes = simulator(
        # The unperturbed policy comes first, because its episodes are often the longest.
        policy.with_weights(jnp.concatenate([unperturbed, perturbed])),
        start_keys(key, settings),
        settings.episode_length,
    )
    return Exploration(episodes, num_evaluations)


def start_keys(key: jax.Array, settings: Any) -> jax.Array:
    """Return the ``(E + 2N,)`` keys of the initial states of :func:`explore`."""
    evaluation_key, search_key = jax.random.split(key)
    keys = (
        jax.random.split(evaluation_key, settings.num_evaluation_episodes),
        jax.random.split(search_key, (2, settings.num_directions)).ravel(),
    )
    return jnp.concatenate(keys)
