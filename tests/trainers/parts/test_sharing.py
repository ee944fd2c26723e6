import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh

from ailsrs_jax.trainers.parts.sharing import AXIS, shared

EMPTY, FULL = jnp.zeros((0, 3)), jnp.arange(3.0)


def sums(x: jax.Array, more: dict[str, jax.Array]) -> dict[str, jax.Array]:
    """``(B, 3), (B,) -> (B,)``; refers to arrays, one of them empty."""

    def one(x: jax.Array, more: jax.Array) -> jax.Array:
        return jnp.concatenate([EMPTY, (FULL + x)[None]]).sum() + EMPTY.sum() + more

    return {"sums": jax.vmap(one)(x, more["more"])}


def test_devices_share_a_function_that_refers_to_an_empty_array() -> None:
    """On jax 0.11 the process would end otherwise; on every version no empty array is passed."""
    function = shared(sums, Mesh(np.array(jax.devices()[:2]), (AXIS,)))
    x, more = jnp.ones((4, 3)), {"more": jnp.arange(4.0)}
    traced = jax.make_jaxpr(function)(x, more)
    (equation,) = (each for each in traced.eqns if each.primitive.name == "shard_map")
    assert len(equation.invars) == 3  # the arguments, and FULL
    assert all(each.aval.size for each in equation.invars)
    result = jax.jit(function)(x, more)["sums"]
    np.testing.assert_array_equal(result, 6.0 + np.arange(4))
