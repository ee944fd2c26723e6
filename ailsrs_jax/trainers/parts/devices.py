"""The devices that share the directions of an iteration."""

import dataclasses
from collections.abc import Callable
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
from jax.sharding import Mesh, PartitionSpec

from ailsrs_jax.errors import UserError

AXIS = "directions"

Tree = TypeVar("Tree")

# Where an array is. Of type Any, because they stand in the place of the arrays in a state.
EVERYWHERE: Any = PartitionSpec()  # the same on every device


def shared(axis: int) -> Any:
    """Where an array is of which each device has a part along ``axis``."""
    return PartitionSpec(*[None] * axis, AXIS)


@dataclasses.dataclass(frozen=True)
class Devices:
    """A mesh with the one axis ``directions``; without one, the default device alone.

    The methods are what a function run by :meth:`split` may say to the other devices, and do
    nothing where there are none.
    """

    mesh: Mesh | None = None

    @property
    def count(self) -> int:
        """How many there are."""
        return 1 if self.mesh is None else self.mesh.size

    def require_share(self, num_directions: int) -> None:
        """Raise UserError unless every device gets as many of ``num_directions``."""
        if num_directions % self.count:
            raise UserError(
                f"{num_directions} directions cannot be shared evenly by {self.count} devices: "
                "set num_directions to a multiple"
            )

    def split(self, function: Callable[..., Any], out_specs: Any, *in_specs: Any) -> Any:
        """``function`` as every device runs it, on its parts of arguments and results."""
        if self.mesh is None:
            return function
        # What is said to be the same everywhere is computed from the same numbers on all devices,
        # or agreed upon, which JAX cannot see.
        return jax.shard_map(
            function, mesh=self.mesh, in_specs=in_specs, out_specs=out_specs, check_vma=False
        )

    def first(self, array: jax.Array, axis: int = 0) -> jax.Array | int:
        """Index along ``axis`` of what is the first of this device's part of ``array``."""
        if self.mesh is None:
            return 0
        return jax.lax.axis_index(AXIS) * (array.shape[axis] // self.count)

    def mine(self, array: jax.Array, axis: int = 0) -> jax.Array:
        """This device's part of an ``array`` that is the same everywhere."""
        self.require_share(array.shape[axis])
        size = array.shape[axis] // self.count
        return jax.lax.dynamic_slice_in_dim(array, self.first(array, axis), size, axis)

    def gather(self, part: jax.Array, axis: int = 0) -> jax.Array:
        """The whole array, of all devices' parts."""
        if self.mesh is None:
            return part
        return jax.lax.all_gather(part, AXIS, axis=axis, tiled=True)

    def agree(self, tree: Tree) -> Tree:
        """What the first device has, of numbers that can differ in their last bits."""
        if self.mesh is None:
            return tree
        is_first = jax.lax.axis_index(AXIS) == 0
        return self.sum(jax.tree.map(lambda x: jnp.where(is_first, x, jnp.zeros_like(x)), tree))

    def sum(self, tree: Tree) -> Tree:
        """The sum of what all devices have."""
        return tree if self.mesh is None else jax.lax.psum(tree, AXIS)


ONE_DEVICE = Devices()
