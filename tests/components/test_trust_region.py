import hypothesis.extra.numpy as arrays
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.integrate
import scipy.stats
from hypothesis import given, settings
from hypothesis import strategies as st

from ailsrs_jax.components.trust_region import (
    fisher_product,
    gaussian_divergence,
    gaussian_log_density,
    generalized_advantages,
    trust_region_step,
)

NUMBERS = st.floats(-10, 10, width=32)


@settings(deadline=None, max_examples=50)
@given(
    numbers=arrays.arrays(np.float32, (3, 12), elements=NUMBERS),
    flags=arrays.arrays(bool, (2, 12)),
    discount=st.floats(0, 1),
    decay=st.floats(0, 1),
)
def test_advantages_are_discounted_sums_of_errors(
    numbers: np.ndarray, flags: np.ndarray, discount: float, decay: float
) -> None:
    """By the definition, A_t = Σ_l (γλ)^l δ_{t+l} up to the episode's end."""
    rewards, values, next_values = numbers
    terminated, over = flags[0] & flags[1], flags[1]
    errors = rewards + discount * next_values * ~terminated - values
    expected = np.zeros(12)
    for start in range(12):
        for step in range(start, 12):
            expected[start] += (discount * decay) ** (step - start) * errors[step]
            if over[step]:
                break
    advantages = generalized_advantages(
        *map(jnp.asarray, (rewards, values, next_values, terminated, over)),
        discount=discount,
        decay=decay,
    )
    np.testing.assert_allclose(advantages, expected, rtol=1e-4, atol=1e-3)


def test_advantages_with_all_decay_are_returns_less_values() -> None:
    rewards, values = jnp.array([1.0, 2.0, 4.0]), jnp.array([5.0, 6.0, 7.0])
    end = jnp.array([False, False, True])
    advantages = generalized_advantages(
        rewards, values, jnp.array([6.0, 7.0, 100.0]), end, end, discount=0.5, decay=1.0
    )
    np.testing.assert_allclose(advantages, [1 + 1 + 1 - 5, 2 + 2 - 6, 4 - 7])


def test_a_time_limit_is_no_terminal_state() -> None:
    false, true = jnp.array([False]), jnp.array([True])
    for terminated, expected in ((false, 1 + 0.5 * 8 - 3), (true, 1 - 3)):
        advantage = generalized_advantages(
            jnp.ones(1), 3 * jnp.ones(1), 8 * jnp.ones(1), terminated, true, discount=0.5, decay=0.9
        )
        np.testing.assert_allclose(advantage, [expected])


def test_gaussian_log_density_is_scipys() -> None:
    rng = np.random.default_rng(0)
    actions, means, log_std = rng.normal(size=(4, 3)), rng.normal(size=(4, 3)), rng.normal(size=3)
    expected = scipy.stats.norm(means, np.exp(log_std)).logpdf(actions).sum(axis=1)
    np.testing.assert_allclose(
        gaussian_log_density(*map(jnp.float32, (actions, means, log_std))), expected, rtol=1e-5
    )


def test_gaussian_divergence_is_the_integral_of_its_definition() -> None:
    p, q = scipy.stats.norm(0.3, 0.7), scipy.stats.norm(-0.5, 1.4)
    integral, _ = scipy.integrate.quad(lambda x: p.pdf(x) * (p.logpdf(x) - q.logpdf(x)), -10, 10)
    one, log = jnp.ones(1), lambda x: jnp.log(jnp.array([x]))
    divergence = gaussian_divergence(0.3 * one, log(0.7), -0.5 * one, log(1.4))
    np.testing.assert_allclose(divergence, integral, rtol=1e-5)


def test_fisher_product_is_the_fisher_matrix_of_a_linear_gaussian() -> None:
    """For means W x and a fixed σ the Fisher matrix of W's rows is E[x xᵀ] / σ²."""
    rng = np.random.default_rng(1)
    x, weights, vector = (rng.normal(size=shape).astype(np.float32) for shape in ((50, 4), 4, 4))
    log_std = jnp.log(jnp.array([0.5]))
    means = (x @ weights)[:, None]

    def divergence(candidate: jax.Array) -> jax.Array:
        return gaussian_divergence(means, log_std, (x @ candidate)[:, None], log_std).mean()

    product = fisher_product(divergence, jnp.asarray(weights), jnp.asarray(vector))
    np.testing.assert_allclose(product, x.T @ x / 50 / 0.25 @ vector, rtol=1e-4)
    dense = jax.hessian(divergence)(jnp.asarray(weights))
    np.testing.assert_allclose(product, dense @ vector, rtol=1e-4)


SMALL = {"max_divergence": 0.01, "iterations": 20, "damping": 0.0, "num_backtracks": 10}


def quadratic() -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(2)
    root = rng.normal(size=(5, 5))
    return (root @ root.T + np.eye(5)).astype(np.float32), rng.normal(size=5).astype(np.float32)


@pytest.mark.parametrize("damping", [0.0, 0.3])
def test_step_is_the_dense_solution(damping: float) -> None:
    """With a gain g·θ and a divergence ½ θᵀFθ the step is x √(2d / xᵀ(F + cI)x)."""
    fisher, gradient = quadratic()
    start = jnp.ones(5)
    divergence = lambda theta: 0.5 * (theta - start) @ fisher @ (theta - start)  # noqa: E731
    after, metrics = trust_region_step(
        start,
        lambda theta: gradient @ theta,
        divergence,
        divergence,
        **SMALL | {"damping": damping},
    )
    damped = fisher + damping * np.eye(5)
    x = np.linalg.solve(damped, gradient)
    step = x * np.sqrt(2 * 0.01 / (x @ damped @ x))
    np.testing.assert_allclose(after - start, step, rtol=1e-3)
    np.testing.assert_allclose(metrics["divergence"], 0.5 * step @ fisher @ step, rtol=1e-2)


def test_a_step_that_goes_too_far_is_halved() -> None:
    """The divergence is six times what its curvature says: a quarter of the length is within."""
    fisher, gradient = quadratic()
    curvature = lambda theta: 0.5 * theta @ fisher @ theta  # noqa: E731
    full, _ = trust_region_step(
        jnp.zeros(5), lambda theta: gradient @ theta, curvature, curvature, **SMALL
    )
    halved, metrics = trust_region_step(
        jnp.zeros(5),
        lambda theta: gradient @ theta,
        lambda theta: 6.1 * curvature(theta),
        curvature,
        **SMALL,
    )
    np.testing.assert_allclose(halved, full / 4, rtol=1e-4)
    np.testing.assert_allclose(metrics["divergence"], 6.1 * 0.01 / 16, rtol=1e-2)


@pytest.mark.parametrize("value", [np.nan, -1.0])
def test_without_an_improvement_the_parameters_stay(value: float) -> None:
    fisher, gradient = quadratic()
    start = {"a": jnp.zeros(2), "b": jnp.zeros(3)}
    flat = lambda theta: jnp.concatenate([theta["a"], theta["b"]])  # noqa: E731
    divergence = lambda theta: 0.5 * flat(theta) @ fisher @ flat(theta)  # noqa: E731

    def gain(theta: dict[str, jax.Array]) -> jax.Array:
        moved = jnp.abs(flat(theta)).max() > 0
        return jnp.where(moved, value, 0.0) + gradient @ flat(theta) * 1e-3

    after, metrics = trust_region_step(start, gain, divergence, divergence, **SMALL)
    assert not flat(after).any()
    assert float(metrics["divergence"]) == 0.0


def test_no_gradient_no_step() -> None:
    zero = lambda theta: 0.0 * theta.sum()  # noqa: E731
    divergence = lambda theta: 0.5 * theta @ theta  # noqa: E731
    after, _ = trust_region_step(jnp.zeros(3), zero, divergence, divergence, **SMALL)
    np.testing.assert_array_equal(after, np.zeros(3))
