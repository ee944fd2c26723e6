import jax
import jax.numpy as jnp
import numpy as np
from scipy import stats

from ailsrs_jax.components import energy_distance as module


def energy_distance(x: jax.Array, y: jax.Array) -> jax.Array:
    return module.energy_distance(x, y, module.mean_distance(y, y))


def test_equals_scipy_in_one_dimension() -> None:
    x, y = jax.random.normal(jax.random.key(0), (200, 1)), jnp.linspace(0.0, 3.0, 90)[:, None]
    expected = stats.energy_distance(x[:, 0], y[:, 0]) ** 2  # SciPy returns the square root
    np.testing.assert_allclose(energy_distance(x, y), expected, rtol=1e-3)


def test_equals_the_definition_in_several_dimensions() -> None:
    x = jax.random.normal(jax.random.key(0), (30, 5))
    y = 2.0 * jax.random.normal(jax.random.key(1), (40, 5)) + 1.0

    def mean_distance(a: jax.Array, b: jax.Array) -> np.floating:
        return np.mean([[np.linalg.norm(p - q) for q in np.asarray(b)] for p in np.asarray(a)])

    expected = 2 * mean_distance(x, y) - mean_distance(x, x) - mean_distance(y, y)
    np.testing.assert_allclose(energy_distance(x, y), expected, rtol=1e-3)


def test_is_the_same_far_from_the_origin() -> None:
    x = jax.random.normal(jax.random.key(0), (200, 11))
    y = 2.0 * jax.random.normal(jax.random.key(1), (150, 11)) + 1.0
    near = energy_distance(x, y)
    np.testing.assert_allclose(energy_distance(x + 1e4, y + 1e4), near, rtol=1e-3)


def test_grows_with_the_difference() -> None:
    x = jax.random.normal(jax.random.key(0), (300, 3))
    y = jax.random.normal(jax.random.key(1), (300, 3))
    distances = [float(energy_distance(x, y + shift)) for shift in (0.0, 0.5, 1.0, 2.0)]
    assert distances == sorted(distances)
    assert distances[0] < 0.05
