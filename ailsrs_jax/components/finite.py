"""Keep learned numbers finite."""

from typing import TypeVar

import jax
import jax.numpy as jnp

Tree = TypeVar("Tree")


def finite_or(new: Tree, old: Tree) -> Tree:
    """Return ``new`` if all of its numbers are finite, else ``old``."""
    finite = jnp.stack([jnp.isfinite(leaf).all() for leaf in jax.tree.leaves(new)]).all()
    return jax.tree.map(lambda x, y: jnp.where(finite, x, y), new, old)
