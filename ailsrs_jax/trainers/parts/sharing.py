"""Devices that share a batch."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jax.sharding import Mesh, PartitionSpec

AXIS = "episodes"  # of a mesh of devices
SHARE = PartitionSpec(AXIS)  # of an array's first axis


def shared(function: Callable[..., Any], mesh: Mesh, out_specs: Any = SHARE) -> Callable[..., Any]:
    """Let each device of ``mesh`` compute ``function`` of its share of the arguments' first axis.

    ``jax.shard_map`` passes the arrays that ``function`` refers to as further arguments. If one of
    them is empty, as many in an MJX model are, XLA of jax 0.11 ends the process while it compiles.
    So ``function`` makes its empty arrays itself.
    """

    def with_own_empty_arrays(*arguments: Any) -> Any:
        traced, shape = jax.make_jaxpr(function, return_shape=True)(*arguments)
        constants = [x if x.size else jnp.zeros(x.shape, x.dtype) for x in traced.consts]
        results = jax.core.eval_jaxpr(traced.jaxpr, constants, *jax.tree.leaves(arguments))
        return jax.tree.unflatten(jax.tree.structure(shape), results)

    return jax.shard_map(
        with_own_empty_arrays,
        mesh=mesh,
        in_specs=SHARE,
        out_specs=out_specs,
        check_vma=False,
    )
