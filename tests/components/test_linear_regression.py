import jax
import jax.numpy as jnp
import numpy as np

from ailsrs_jax.components.linear_regression import (
    NUM_FOLDS,
    PENALTIES,
    affine_regression,
    ridge_regression,
)

RNG = np.random.default_rng(0)


def samples(num_samples: int, noise: float) -> tuple[np.ndarray, np.ndarray]:
    """Inputs and targets of an affine function, in two episodes."""
    inputs = RNG.normal(size=(2, num_samples // 2, 6)).astype(np.float32)
    targets = inputs @ RNG.normal(size=(6, 3)) + [1.0, -2.0, 0.5]
    return inputs, (targets + noise * RNG.normal(size=targets.shape)).astype(np.float32)


def affine_ridge(x: np.ndarray, y: np.ndarray, penalty: float) -> np.ndarray:
    """The normal equations of ridge regression with an intercept that has no penalty."""
    ones = np.column_stack([x, np.ones(len(x))]).astype(float)
    penalties = penalty * len(x) * np.diag([1.0] * x.shape[1] + [0.0])
    return np.linalg.solve(ones.T @ ones + penalties, ones.T @ y).T


def test_ridge_regression_minimises_its_loss() -> None:
    inputs, targets = samples(40, noise=1.0)
    mask = np.arange(20) < np.array([[20], [7]])
    x, y = inputs[mask].astype(float), targets[mask].astype(float)
    expected = np.linalg.solve(x.T @ x / 27 + 0.3 * np.eye(6), x.T @ y / 27).T
    weights = jax.jit(ridge_regression)(inputs, targets, mask, 0.3)
    np.testing.assert_allclose(weights, expected, rtol=1e-4, atol=1e-5)


def test_ridge_regression_recovers_a_linear_map_and_ignores_the_masked() -> None:
    weights = jax.random.normal(jax.random.key(0), (2, 5))
    inputs = jax.random.normal(jax.random.key(1), (4, 50, 5))
    mask = jnp.arange(50) < jnp.array([[50], [20], [1], [0]])
    targets = jnp.where(mask[..., None], inputs @ weights.T, jnp.nan)
    found = jax.jit(ridge_regression)(inputs, targets, mask, penalty=1e-6)
    np.testing.assert_allclose(found, weights, atol=1e-3)


def test_affine_regression_takes_the_penalty_that_cross_validation_prefers() -> None:
    chosen = set()
    for num_samples, noise in ((60, 0.0), (16, 3.0), (16, 10.0)):
        inputs, targets = samples(num_samples, noise)
        mask = np.arange(num_samples // 2) < np.array([[num_samples // 2], [num_samples // 2 - 1]])
        x, y = inputs[mask], targets[mask]
        fold = np.arange(len(x)) * NUM_FOLDS // len(x)

        def error(penalty: float, x=x, y=y, fold=fold) -> float:
            errors = 0.0
            for held_out in range(NUM_FOLDS):
                weights = affine_ridge(x[fold != held_out], y[fold != held_out], penalty)
                predicted = x[fold == held_out] @ weights[:, :-1].T + weights[:, -1]
                errors += np.square(predicted - y[fold == held_out]).sum()
            return errors

        best = min(PENALTIES, key=error)
        chosen.add(best)
        weights = jax.jit(affine_regression)(inputs, targets, mask)
        np.testing.assert_allclose(weights, affine_ridge(x, y, best), rtol=1e-3, atol=1e-4)
    assert len(chosen) > 1


def test_unseen_inputs_get_no_weight() -> None:
    inputs, targets = samples(40, noise=0.1)
    mask = jnp.ones(inputs.shape[:2], bool)
    weights = affine_regression(inputs * np.array([1, 1, 1, 1, 0, 0]), targets, mask)
    assert not weights[:, 4:6].any()
    assert weights[:, -1].all()
