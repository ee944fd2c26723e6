"""Where the episodes of an iteration start."""

from typing import Any

import jax
import jax.numpy as jnp

from ailsrs_jax.components.sampling import sample_steps
from ailsrs_jax.envs.interface import starts_at_observations
from ailsrs_jax.trainers.parts.reference import Reference
from ailsrs_jax.trainers.parts.rollout import Starts
from ailsrs_jax.trainers.parts.settings import is_used


def draw_starts(
    env: Any, reference: Reference, key: jax.Array, num_starts: int, demonstrated: jax.Array | float
) -> Starts:
    """Draw ``(num_starts,)`` starts: the task's own resets, and states of the demonstrations.

    Args:
        env: the environment. If it cannot be put into a state, all starts are resets.
        reference: the demonstrations.
        key: of the draws.
        num_starts: how many.
        demonstrated: the share of them that are demonstrated states, drawn uniformly from all. A
            share that makes no whole number is met on average.
    """
    reset_key, step_key, share_key = jax.random.split(key, 3)
    resets = jax.random.split(reset_key, num_starts)
    if not is_used(demonstrated) or not starts_at_observations(env):
        return resets
    episode, time = sample_steps(step_key, reference.lengths, num_starts)
    states = jax.vmap(env.state_at)(reference.unstandardize(reference.observations[episode, time]))
    # Systematic sampling: each start counts with the probability ``demonstrated``.
    edges = jnp.floor(demonstrated * jnp.arange(num_starts + 1) + jax.random.uniform(share_key))
    chosen = jnp.diff(edges) > 0
    return jax.tree.map(
        lambda state, reset: jnp.where(chosen.reshape(-1, *[1] * (state.ndim - 1)), state, reset),
        states,
        jax.vmap(env.draw_start)(resets),
    )
