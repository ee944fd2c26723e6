"""Episodes that end one step late, to see what their last action led to."""

import jax
import jax.numpy as jnp
from flax import struct

from ailsrs_jax.envs import State, Wrapper


class LateState(struct.PyTreeNode):
    """What a rollout needs of a state, around that of the environment."""

    env_state: State  # of the environment inside, with its own done
    obs: jax.Array  # (n,)
    reward: jax.Array  # ()
    done: jax.Array  # ()


class LateEnd(Wrapper):
    """The environment ``env``, but ``done`` comes one step later, in which nothing happens.

    A rollout records an observation before each step, and so, with one step more, the final one.
    """

    def reset(self, rng: jax.Array) -> LateState:
        """Start an episode, as ``env`` does with the key ``rng``."""
        state = self.env.reset(rng)
        return LateState(state, state.obs, state.reward, jnp.zeros_like(state.done))

    def step(self, state: LateState, action: jax.Array) -> LateState:
        """Apply ``action (p,)``, unless the episode has ended: then it is over."""
        ended = state.env_state.done
        # Engines do not simulate what is done, nor what the rollout calls so.
        done = jnp.maximum(ended, state.done)
        after = self.env.step(state.env_state.replace(done=done), action)
        return LateState(
            env_state=after.replace(done=jnp.maximum(ended, after.done)),
            obs=jnp.where(ended != 0, state.obs, after.obs),
            reward=jnp.where(ended != 0, 0.0, after.reward),
            done=ended,
        )
