"""Behaviour cloning of a linear policy, solved exactly."""

import functools

import jax
import jax.numpy as jnp

PENALTIES = (1e-4, 1e-3, 1e-2, 1e-1, 1.0)
NUM_FOLDS = 5


def ridge_regression(
    inputs: jax.Array, targets: jax.Array, mask: jax.Array, penalty: float | jax.Array = 1e-4
) -> jax.Array:
    """Return the ``W (p, n)`` that minimises mean ‖W x − y‖² + penalty ‖W‖² over masked samples.

    The ``inputs (..., n)`` x are standardised, the ``targets (..., p)`` are y, and ``mask (...)``
    is true for samples that count. The penalty makes the solution unique when inputs are collinear
    or few.
    """
    mask = mask.reshape(-1, 1)
    x = jnp.where(mask, inputs.reshape(-1, inputs.shape[-1]), 0.0)
    y = jnp.where(mask, targets.reshape(-1, targets.shape[-1]), 0.0)
    count = jnp.maximum(mask.sum(), 1)
    gram = jnp.matmul(x.T, x, precision="highest") / count
    moments = jnp.matmul(x.T, y, precision="highest") / count
    return jnp.linalg.solve(gram + penalty * jnp.eye(x.shape[-1]), moments).T


def affine_regression(inputs: jax.Array, targets: jax.Array, mask: jax.Array) -> jax.Array:
    """Return ``[W, b] (p, n + 1)``: W by ridge regression, and b, which has no penalty.

    The penalty is the one of :data:`PENALTIES` with the smallest squared error in cross-validation.
    Each of five folds is one stretch of the masked samples in their order, because samples that
    follow one another are too alike to detect overfitting. The arguments are those of
    :func:`ridge_regression`.
    """
    matmul = functools.partial(jnp.matmul, precision="highest")
    x, y = (array.reshape(-1, array.shape[-1]) for array in (inputs, targets))
    mask = mask.ravel()
    fold = (jnp.cumsum(mask) - 1) * NUM_FOLDS // jnp.maximum(mask.sum(), 1)

    def fit(mask: jax.Array, penalty: jax.Array) -> jax.Array:
        mean_x = jnp.mean(x, axis=0, where=mask[:, None])
        mean_y = jnp.mean(y, axis=0, where=mask[:, None])
        weights = ridge_regression(x - mean_x, y - mean_y, mask, penalty)
        return jnp.column_stack([weights, mean_y - matmul(weights, mean_x)])

    def error(penalty: jax.Array, held_out: jax.Array) -> jax.Array:
        weights = fit(mask & (fold != held_out), penalty)
        errors = jnp.square(matmul(x, weights[:, :-1].T) + weights[:, -1] - y)
        return jnp.sum(errors, where=(mask & (fold == held_out))[:, None])

    penalties = jnp.array(PENALTIES)
    errors = jax.lax.map(
        lambda penalty: jax.lax.map(lambda k: error(penalty, k), jnp.arange(NUM_FOLDS)).sum(),
        penalties,
    )
    return fit(mask, penalties[jnp.argmin(errors)])
