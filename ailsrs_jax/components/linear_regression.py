"""Behaviour cloning of a linear policy, solved exactly."""

import jax
import jax.numpy as jnp


def ridge_regression(
    inputs: jax.Array, targets: jax.Array, mask: jax.Array, penalty: float = 1e-4
) -> jax.Array:
    """Return the ``W (p, n)`` that minimises mean ‖W x − y‖² + penalty ‖W‖² over masked samples.

    Args:
        inputs: ``(..., n)`` x, standardised.
        targets: ``(..., p)`` y.
        mask: ``(...)`` bool, the samples that count.
        penalty: makes the solution unique when inputs are collinear or few.
    """
    mask = mask.reshape(-1, 1)
    x = jnp.where(mask, inputs.reshape(-1, inputs.shape[-1]), 0.0)
    y = jnp.where(mask, targets.reshape(-1, targets.shape[-1]), 0.0)
    count = jnp.maximum(mask.sum(), 1)
    gram = jnp.matmul(x.T, x, precision="highest") / count
    moments = jnp.matmul(x.T, y, precision="highest") / count
    return jnp.linalg.solve(gram + penalty * jnp.eye(x.shape[-1]), moments).T
