"""Simulations that have diverged."""

import jax
import jax.numpy as jnp

from ailsrs_jax.envs import State, Wrapper
from ailsrs_jax.envs.physics.base import LARGEST


def has_diverged(before: State, action: jax.Array, after: State) -> jax.Array:
    """``()`` bool: the step from ``before`` to ``after`` holds NaN or a number beyond LARGEST.

    Both observations, ``action (p,)`` and the reward are examined.
    """
    numbers = (before.obs, action, after.obs, after.reward)
    # Comparisons with NaN are false.
    return ~jnp.all(jnp.stack([jnp.all(jnp.abs(x) <= LARGEST) for x in numbers]))


class EndDiverged(Wrapper):
    """Ends a diverging episode in its last finite state, as a terminal state without reward.

    It is for other libraries' trainers; the trainers of this package leave such episodes out.
    """

    def step(self, state: State, action: jax.Array) -> State:
        """Apply ``action (p,)``."""
        after = self.env.step(state, action)
        diverged = has_diverged(state, action, after)
        ended = state.replace(reward=jnp.zeros_like(state.reward), done=jnp.ones_like(state.done))
        return jax.tree.map(lambda old, new: jnp.where(diverged, old, new), ended, after)
