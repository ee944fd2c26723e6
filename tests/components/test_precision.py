"""Where a GPU may not round factors of products to TF32; docs/numerics.md promises it."""

from collections.abc import Callable, Iterator
from typing import Any

import jax
import jax.numpy as jnp
import pytest
from jax.extend.core import ClosedJaxpr, Jaxpr

from ailsrs_jax.components import linear_regression, random_search
from ailsrs_jax.components.energy_distance import energy_distance
from ailsrs_jax.components.policy import LinearPolicy, MlpPolicy

VECTOR, MATRIX = jnp.ones(3), jnp.ones((7, 3))
BOUNDS = -jnp.ones(2), jnp.ones(2)
LINEAR = LinearPolicy(jnp.ones((2, 3)), VECTOR, VECTOR, *BOUNDS, intercept=jnp.ones(2))
NETWORK = MlpPolicy(
    weights=(jnp.ones((4, 3)), jnp.ones((2, 4))),
    biases=(jnp.ones(4), jnp.ones(2)),
    mean=VECTOR,
    std=VECTOR,
    action_low=BOUNDS[0],
    action_high=BOUNDS[1],
    action_std=jnp.ones(2),
)
MASK = jnp.ones(7, bool)
PRODUCTS: dict[str, tuple[Callable[..., Any], tuple[Any, ...]]] = {
    "a linear policy": (LINEAR, (VECTOR,)),
    "a network": (NETWORK, (VECTOR,)),
    "ridge regression": (linear_regression.ridge_regression, (MATRIX, MATRIX, MASK)),
    "affine regression": (linear_regression.affine_regression, (MATRIX, MATRIX, MASK)),
    "the energy distance": (energy_distance, (MATRIX, MATRIX, jnp.ones(()))),
    "a step of the search": (
        lambda *arguments: random_search.step(*arguments, step_size=0.1, num_top_directions=2),
        (jnp.ones((2, 3)), jnp.ones((4, 2, 3)), jnp.arange(4.0), jnp.ones(4)),
    ),
}


def products(jaxpr: Jaxpr) -> Iterator[Any]:
    """The precisions of all matrix products, in inner programs, too."""
    for equation in jaxpr.eqns:
        if equation.primitive.name == "dot_general":
            yield equation.params["precision"]
        for inner in jax.tree.leaves(
            list(equation.params.values()), is_leaf=lambda x: isinstance(x, Jaxpr | ClosedJaxpr)
        ):
            if isinstance(inner, ClosedJaxpr):
                yield from products(inner.jaxpr)
            elif isinstance(inner, Jaxpr):
                yield from products(inner)


@pytest.mark.parametrize("name", PRODUCTS)
def test_products_are_of_float32(name: str) -> None:
    function, arguments = PRODUCTS[name]
    found = list(products(jax.make_jaxpr(function)(*arguments).jaxpr))
    highest = jax.lax.Precision.HIGHEST
    assert set(found) <= {highest, (highest, highest)}, found
    assert found or name == "the energy distance"
