"""The linear policy, a = clip(M diag(Σ)^(−1/2) (s − μ)), and the choice of which one to keep."""

import jax
import jax.numpy as jnp
from flax import struct


class LinearPolicy(struct.PyTreeNode):
    """A deterministic linear policy of standardised observations.

    With leading batch axes on its leaves it is a batch of policies, as ``jax.vmap`` makes them.
    """

    weights: jax.Array  # (p, n) M
    mean: jax.Array  # (n,) μ
    std: jax.Array  # (n,) the square root of Σ's diagonal
    action_low: jax.Array  # (p,)
    action_high: jax.Array  # (p,)

    def __call__(self, observation: jax.Array) -> jax.Array:
        """The action ``(p,)``, within the actuators' range, for one observation ``(n,)``."""
        # Not in TF32, so that the policy is the one that NumPy computes from the exported file.
        standardized = (observation - self.mean) / self.std
        action = jnp.matmul(self.weights, standardized, precision="highest")
        return jnp.clip(action, self.action_low, self.action_high)

    def with_weights(self, weights: jax.Array) -> "LinearPolicy":
        """The batch of policies with these ``weights (B, p, n)`` and this one's statistics."""
        batch = jax.tree.map(lambda x: jnp.broadcast_to(x, (len(weights), *x.shape)), self)
        return batch.replace(weights=weights)


class KeptPolicy(struct.PyTreeNode):
    """The best policy so far by some score."""

    policy: LinearPolicy
    score: jax.Array  # () higher is better; −∞ before the first candidate
    iteration: jax.Array  # () int32, when it was found

    def offer(self, policy: LinearPolicy, score: jax.Array, iteration: jax.Array) -> "KeptPolicy":
        """Keep ``policy`` instead if its score is higher; a score that is NaN never is."""
        candidate = KeptPolicy(policy, score, iteration)
        better = score > self.score
        return jax.tree.map(lambda new, old: jnp.where(better, new, old), candidate, self)


def keep(policy: LinearPolicy) -> KeptPolicy:
    """Start with ``policy``, to be replaced by the first candidate that has a score."""
    return KeptPolicy(
        policy, score=jnp.full((), -jnp.inf, jnp.float32), iteration=jnp.zeros((), jnp.int32)
    )
