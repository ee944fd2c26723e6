"""The episodes of one iteration of random search."""

import jax
import jax.numpy as jnp

from ailsrs_jax.components import random_search
from ailsrs_jax.components.policy import LinearPolicy
from ailsrs_jax.envs import Env
from ailsrs_jax.trainers.parts.devices import Devices
from ailsrs_jax.trainers.parts.rollout import Episodes, episode_counts, simulate


def explore(
    env: Env,
    policy: LinearPolicy,
    deltas: jax.Array,
    key: jax.Array,
    *,
    noise_std: float | jax.Array,
    num_evaluation_episodes: int,
    episode_length: int,
    devices: Devices,
    batch_size: int | None,
) -> Episodes:
    """Roll out the unperturbed policy and, in the same batch, the perturbed ones.

    Args:
        env: the environment.
        policy: the unperturbed policy.
        deltas: ``(N, p, n)`` unit noise, the same on all devices.
        key: of the initial states.
        noise_std: ν.
        num_evaluation_episodes: E, episodes of the unperturbed policy.
        episode_length: T.
        devices: each perturbs along its own N' of the N directions, and evaluates on its own.
        batch_size: simulations of a device at a time; by default all.

    Returns:
        E + 2N' episodes: first the unperturbed policy's, which often live the longest, then those
        of ``M + ν δ``, then those of ``M − ν δ``. In one piece, because a part would be a copy.
    """
    perturbed = random_search.perturb(policy.weights, devices.mine(deltas), noise_std)
    unperturbed = jnp.tile(policy.weights, (num_evaluation_episodes, 1, 1))
    evaluation_key, exploration_key = jax.random.split(key)
    evaluation_keys = jax.random.split(evaluation_key, num_evaluation_episodes)
    exploration_keys = devices.mine(jax.random.split(exploration_key, (2, len(deltas))), axis=1)
    return simulate(
        env,
        policy.with_weights(jnp.concatenate([unperturbed, perturbed])),
        jnp.concatenate([evaluation_keys, exploration_keys.ravel()]),
        episode_length,
        batch_size,
    )


def count_episodes(
    batch: Episodes, num_evaluation_episodes: int, devices: Devices
) -> dict[str, jax.Array]:
    """The counts of what :func:`explore` gave, of all devices.

    The evaluation episodes are the same on every device, and count once.
    """
    evaluation, exploration = (
        episode_counts(episodes)
        for episodes in (
            batch.episodes(0, num_evaluation_episodes),
            batch.episodes(num_evaluation_episodes),
        )
    )
    return jax.tree.map(jnp.add, devices.sum(exploration), devices.agree(evaluation))
