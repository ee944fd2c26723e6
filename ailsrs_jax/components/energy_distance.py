"""Energy distance between two samples (Székely and Rizzo, 2013)."""

import jax
import jax.numpy as jnp


def energy_distance(x: jax.Array, y: jax.Array, y_spread: jax.Array) -> jax.Array:
    """Estimate D(X, Y) = 2 E‖X − Y‖ − E‖X − X'‖ − E‖Y − Y'‖ from ``x (m, d)`` and ``y (k, d)``.

    D is zero exactly if both have the same distribution. The estimate includes the pairs of a row
    with itself, so it is never negative, and too large by E‖X − X'‖ / m + E‖Y − Y'‖ / k.
    ``y_spread`` is ``mean_distance(y, y)``, which is computed once if ``y`` stays the same.
    """
    return 2.0 * mean_distance(x, y) - mean_distance(x, x) - y_spread


def mean_distance(x: jax.Array, y: jax.Array) -> jax.Array:
    """Return E‖X − Y‖ over all pairs of rows of ``x (m, d)`` and ``y (k, d)``."""
    # Far from the origin, float32 would lose the distances in the squares below.
    center = jnp.mean(y, axis=0)
    x, y = x - center, y - center
    # ‖x − y‖² = ‖x‖² + ‖y‖² − 2 x·y: one matrix product instead of an (m, k, d) array.
    products = jnp.matmul(x, y.T, precision="highest")
    squares = jnp.sum(x * x, -1)[:, None] + jnp.sum(y * y, -1) - 2.0 * products
    return jnp.mean(jnp.sqrt(jnp.maximum(squares, 0.0)))
