import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ailsrs_jax.components import random_search


def numpy_step(weights, deltas, plus, minus, step_size, num_top, scale_by_std):
    """Written from the ARS paper's Algorithms 1 and 2, in float64."""
    order = sorted(range(len(plus)), key=lambda i: -max(plus[i], minus[i]))[:num_top]
    used = np.array([plus[i] for i in order] + [minus[i] for i in order])
    sigma = used.std() if scale_by_std else 1.0
    if sigma == 0:
        return weights
    update = sum((plus[i] - minus[i]) * deltas[i] for i in order)
    return weights + step_size / (num_top * sigma) * update


returns = st.lists(st.sampled_from([-2.0, 0.0, 0.5, 1.0, 3.0]), min_size=6, max_size=6)


@settings(max_examples=100, deadline=None)
@given(
    plus=returns, minus=returns, num_top=st.integers(1, 6), scale=st.booleans(), seed=st.integers(0)
)
def test_equals_the_reference_ties_included(plus, minus, num_top, scale, seed) -> None:
    rng = np.random.default_rng(seed % 2**32)
    weights, deltas = rng.normal(size=(2, 3)), rng.normal(size=(6, 2, 3))
    expected = numpy_step(weights, deltas, plus, minus, 0.1, num_top, scale)
    actual = random_search.step(
        *map(jnp.float32, (weights, deltas, plus, minus)),
        step_size=0.1,
        num_top_directions=num_top,
        scale_by_std=scale,
    )
    np.testing.assert_allclose(actual, expected, rtol=2e-5, atol=2e-5)


def test_by_hand() -> None:
    deltas = jnp.array([[[1.0, 0.0]], [[0.0, 1.0]]])
    actual = jax.jit(random_search.step, static_argnames="num_top_directions")(
        jnp.zeros((1, 2)),
        deltas,
        jnp.array([3.0, 0.0]),
        jnp.array([1.0, 0.5]),
        step_size=0.5,
        num_top_directions=1,
    )
    # The first direction alone: (3 − 1) δ / σ(3, 1) = 2 δ, times α / b = 0.5.
    np.testing.assert_allclose(actual, [[1.0, 0.0]])


def test_perturbations_are_mirrored() -> None:
    weights = jnp.full((2, 3), 5.0)
    deltas = jax.random.normal(jax.random.key(0), (4, 2, 3))
    perturbed = random_search.perturb(weights, deltas, 0.1)
    assert perturbed.shape == (8, 2, 3)
    np.testing.assert_allclose(perturbed[:4] + perturbed[4:], 2 * jnp.tile(weights, (4, 1, 1)))
    np.testing.assert_allclose(perturbed[0] - weights, 0.1 * deltas[0], atol=1e-6)


@pytest.mark.parametrize("scale", [True, False])
def test_climbs_a_linear_slope(scale: bool) -> None:
    slope = jnp.array([[1.0, -2.0]])
    deltas = jax.random.normal(jax.random.key(1), (2000, 1, 2))
    gain = jnp.einsum("nij,ij->n", deltas, slope)
    moved = random_search.step(
        jnp.zeros((1, 2)), deltas, gain, -gain, step_size=1.0, num_top_directions=2000,
        scale_by_std=scale,
    )  # fmt: skip
    # E[(r⁺ − r⁻) δ] = 2 slope; σ of ±gain is ‖slope‖.
    expected = 2 * slope / (jnp.linalg.norm(slope) if scale else 1.0)
    np.testing.assert_allclose(moved, expected, rtol=0.1)


@settings(max_examples=100, deadline=None)
@given(
    pairs=st.lists(
        st.tuples(*[st.sampled_from([-2.0, 0.5, 1.0, 3.0, np.nan, np.inf, -np.inf])] * 2),
        min_size=6,
        max_size=6,
    ),
    num_top=st.integers(1, 6),
    scale=st.booleans(),
)
def test_what_diverged_is_ranked_last_and_counts_as_the_lowest(pairs, num_top, scale) -> None:
    rng = np.random.default_rng(0)
    weights, deltas = rng.normal(size=(2, 3)), rng.normal(size=(6, 2, 3))
    plus, minus = np.array(pairs).T
    actual = random_search.step(
        *map(jnp.float32, (weights, deltas, plus, minus)),
        step_size=0.1,
        num_top_directions=num_top,
        scale_by_std=scale,
    )
    finite = [x for x in (*plus, *minus) if np.isfinite(x)]
    if not finite:
        np.testing.assert_array_equal(actual, jnp.float32(weights))
        return
    # Those where both diverged come after those where both are the lowest.
    both = ~np.isfinite(plus) & ~np.isfinite(minus)
    order = np.argsort(both, kind="stable")
    plus, minus = (np.where(np.isfinite(x), x, min(finite))[order] for x in (plus, minus))
    expected = numpy_step(weights, deltas[order], plus, minus, 0.1, num_top, scale)
    np.testing.assert_allclose(actual, expected, rtol=2e-5, atol=2e-5)


@pytest.mark.parametrize("level", [0.0, 1.0, -3000.0, 1e20])
def test_returns_that_differ_by_rounding_teach_nothing(level: float) -> None:
    weights, deltas = jnp.ones((1, 2)), jnp.ones((4, 1, 2))
    returns = jnp.nextafter(jnp.full(4, level, jnp.float32), jnp.inf)
    settings = {"step_size": 1.0, "num_top_directions": 4}
    moved = random_search.step(
        weights, deltas, returns, jnp.full(4, level, jnp.float32), **settings
    )
    np.testing.assert_array_equal(moved, weights)
    further = jnp.full(4, level + max(abs(level) * 1e-4, 1e-10), jnp.float32)
    moved = random_search.step(
        weights, deltas, further, jnp.full(4, level, jnp.float32), **settings
    )
    np.testing.assert_allclose(moved, weights + 2.0, rtol=1e-2)


def test_a_step_that_is_not_finite_is_not_taken() -> None:
    weights, deltas, returns = jnp.ones((1, 2)), jnp.ones((1, 1, 2)), jnp.full(1, 3e38)
    moved = random_search.step(
        weights, deltas, returns, -returns, step_size=1.0, num_top_directions=1, scale_by_std=False
    )
    np.testing.assert_array_equal(moved, weights)


def test_no_number_of_directions_stands_for_all() -> None:
    weights, deltas = jnp.zeros((1, 2)), jax.random.normal(jax.random.key(0), (6, 1, 2))
    returns = jnp.arange(6.0)
    steps = [
        random_search.step(
            weights, deltas, returns, -returns, step_size=0.1, num_top_directions=number
        )
        for number in (0, 6)
    ]
    np.testing.assert_array_equal(*steps)
