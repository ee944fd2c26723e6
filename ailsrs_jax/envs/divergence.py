"""When a simulation has diverged."""

import jax
import jax.numpy as jnp
import mujoco

from ailsrs_jax.envs import State, Wrapper

# Beyond this MuJoCo takes a simulation for unstable; its square, summed, still is a float32.
LARGEST = mujoco.mjMAXVAL  # 1e10


def has_diverged(before: State, action: jax.Array, after: State) -> jax.Array:
    """``()`` bool: a number of the step from ``before`` to ``after`` cannot be learned from.

    That is, in observations, ``action (p,)`` or reward, NaN or one beyond :data:`LARGEST`.
    """
    numbers = (before.obs, action, after.obs, after.reward)
    # Of NaN no comparison is true.
    return ~jnp.all(jnp.stack([jnp.all(jnp.abs(x) <= LARGEST) for x in numbers]))


class EndDiverged(Wrapper):
    """Ends an episode that diverges in its last finite state, as a terminal one without reward.

    For trainers that are not ours; ours leave such an episode out.
    """

    def step(self, state: State, action: jax.Array) -> State:
        """Apply ``action (p,)``."""
        after = self.env.step(state, action)
        diverged = has_diverged(state, action, after)
        ended = state.replace(reward=jnp.zeros_like(state.reward), done=jnp.ones_like(state.done))
        return jax.tree.map(lambda old, new: jnp.where(diverged, old, new), ended, after)
