"""A wrapper that changes when an episode ends."""

import jax
import jax.numpy as jnp

from ailsrs_jax.envs import State, Wrapper
from ailsrs_jax.envs.divergence import has_diverged


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
