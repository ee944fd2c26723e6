import jax.numpy as jnp
import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from ailsrs_jax.components.finite import finite_or, in_units

numbers = st.lists(st.floats(width=32), min_size=1, max_size=4)


@settings(max_examples=50, deadline=None)
@given(first=numbers, second=numbers, count=st.integers(0, 9))
def test_all_or_nothing(first: list[float], second: list[float], count: int) -> None:
    new = {"a": jnp.float32(first), "b": (jnp.float32(second), jnp.int32(count))}
    old = {"a": jnp.zeros(len(first)), "b": (jnp.zeros(len(second)), jnp.int32(-1))}
    chosen = finite_or(new, old)
    expected = new if np.isfinite(first + second).all() else old
    np.testing.assert_array_equal(chosen["a"], expected["a"])
    np.testing.assert_array_equal(chosen["b"][0], expected["b"][0])
    assert chosen["b"][1] == expected["b"][1]


def test_units_are_standard_deviations_unless_these_are_rounding() -> None:
    values = jnp.array([1.0, jnp.nan, 5.0])
    np.testing.assert_allclose(in_units(values), [0.5, np.nan, 2.5])
    same = jnp.full(32, 0.6931472)
    np.testing.assert_array_equal(in_units(same), 0.0)
    last_bits = jnp.where(jnp.arange(32) % 2, same, jnp.nextafter(same, 1.0))
    np.testing.assert_array_equal(in_units(last_bits), 0.0)
