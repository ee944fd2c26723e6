import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ailsrs_jax.components import normalizer


def merge(batches: list[tuple[np.ndarray, np.ndarray]], jit: bool) -> normalizer.RunningStatistics:
    update = jax.jit(normalizer.update) if jit else normalizer.update
    statistics = normalizer.init(batches[0][0].shape[-1])
    for samples, mask in batches:
        statistics = update(statistics, jnp.asarray(samples, jnp.float32), jnp.asarray(mask))
    return statistics


@pytest.mark.parametrize("jit", [False, True])
def test_equals_numpy_on_ragged_masks(jit: bool) -> None:
    rng = np.random.default_rng(0)
    scale, offset = np.array([1.0, 1e-3, 50.0]), np.array([0.0, 3.0, -200.0])
    batches = [
        (rng.normal(size=(steps, 5, 3)) * scale + offset, rng.random((steps, 5)) < 0.6)
        for steps in (7, 1, 30)
    ]
    statistics = merge(batches, jit)
    seen = np.concatenate([samples[mask] for samples, mask in batches])
    assert float(statistics.count) == len(seen)
    np.testing.assert_allclose(statistics.mean, seen.mean(axis=0), rtol=1e-5)
    np.testing.assert_allclose(statistics.std, seen.std(axis=0), rtol=1e-4)


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 1000), split=st.integers(1, 39))
def test_order_and_grouping_do_not_matter(seed: int, split: int) -> None:
    samples = np.random.default_rng(seed).normal(3.0, 2.0, (40, 4))
    whole = merge([(samples, np.ones(40, bool))], jit=False)
    halves = [(part, np.ones(len(part), bool)) for part in (samples[split:], samples[:split])]
    parts = merge(halves, jit=False)
    np.testing.assert_allclose(parts.mean, whole.mean, rtol=1e-4)
    np.testing.assert_allclose(parts.std, whole.std, rtol=1e-4)


def test_nothing_seen_is_mean_zero_and_unit_scale() -> None:
    nobody = (np.full((4, 2), np.nan), np.zeros(4, bool))
    statistics = merge([nobody], jit=False)
    np.testing.assert_array_equal(statistics.mean, [0.0, 0.0])
    np.testing.assert_array_equal(statistics.std, [1.0, 1.0])


@pytest.mark.parametrize("value", [0.0, 1.0, 1234.5678])
def test_a_constant_dimension_is_left_unscaled(value: float) -> None:
    constant = (np.full((100, 1), value), np.ones(100, bool))
    statistics = merge([constant, constant], jit=False)
    np.testing.assert_allclose(statistics.mean, [value], rtol=1e-6)
    np.testing.assert_array_equal(statistics.std, [1.0])
