"""Keep learned numbers finite."""

from typing import TypeVar

import jax
import jax.numpy as jnp

Tree = TypeVar("Tree")


def finite_or(new: Tree, old: Tree) -> Tree:
    """Return ``new`` if all of its numbers are finite, else ``old``."""
    finite = jnp.stack([jnp.isfinite(leaf).all() for leaf in jax.tree.leaves(new)]).all()
    return jax.tree.map(lambda x, y: jnp.where(finite, x, y), new, old)


def mean_of_finite(values: jax.Array) -> jax.Array:
    """Return the mean of the values that are not NaN."""
    mean = values.mean()
    return jnp.where(jnp.isnan(mean), jnp.nanmean(values), mean)


def in_units(values: jax.Array) -> jax.Array:
    """Divide ``values`` by the standard deviation of those that are not NaN.

    If it is rounding, the values say nothing, and the result is 0.
    """
    std = jnp.nanstd(values)
    differs = std > 1e-6 * jnp.nanmax(jnp.abs(values))
    return jnp.where(differs | jnp.isnan(values), values / jnp.where(differs, std, 1.0), 0.0)
