"""Detection of simulations that have diverged."""

import jax
import jax.numpy as jnp

from ailsrs_jax.envs import State
from ailsrs_jax.envs.physics.base import LARGEST


def has_diverged(before: State, action: jax.Array, after: State) -> jax.Array:
    """``()`` bool: the step from ``before`` to ``after`` holds NaN or a number beyond LARGEST.

    Both observations, ``action (p,)`` and the reward are examined.
    """
    numbers = (before.obs, action, after.obs, after.reward)
    # Comparisons with NaN are false.
    return ~jnp.all(jnp.stack([jnp.all(jnp.abs(x) <= LARGEST) for x in numbers]))
