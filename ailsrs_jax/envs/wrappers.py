"""Wrappers that change when an episode ends."""

import jax
import jax.numpy as jnp
from flax import struct

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


class LateState(struct.PyTreeNode):
    """The environment's state, and the fields of it that a rollout reads."""

    env_state: State  # with the environment's own done
    obs: jax.Array  # (n,)
    reward: jax.Array  # ()
    done: jax.Array  # ()


class LateEnd(Wrapper):
    """The environment ``env``, with ``done`` one step later; nothing happens in that step.

    A rollout records the observation before each step. The additional step makes it record the
    final observation as well.
    """

    def reset(self, rng: jax.Array) -> LateState:
        """Start an episode, as ``env`` does with the key ``rng``."""
        state = self.env.reset(rng)
        return LateState(state, state.obs, state.reward, jnp.zeros_like(state.done))

    def step(self, state: LateState, action: jax.Array) -> LateState:
        """Apply ``action (p,)``, or set ``done`` if the episode has ended."""
        ended = state.env_state.done
        # Engines skip episodes that have ended, and those that the rollout has marked as done.
        done = jnp.maximum(ended, state.done)
        after = self.env.step(state.env_state.replace(done=done), action)
        return LateState(
            env_state=after.replace(done=jnp.maximum(ended, after.done)),
            obs=jnp.where(ended != 0, state.obs, after.obs),
            reward=jnp.where(ended != 0, 0.0, after.reward),
            done=ended,
        )
