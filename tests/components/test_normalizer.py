import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import example, given, settings
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


@settings(max_examples=30, deadline=None)
@example(seed=0, offset=798878.25, scale=0.125, sizes=[300])  # of which the plain sum rounds
@given(
    seed=st.integers(0, 1000),
    offset=st.floats(-1e6, 1e6, width=32),
    scale=st.floats(0.0625, 1e4, width=32),
    sizes=st.lists(st.sampled_from([0, 1, 2, 300]), min_size=1, max_size=4),
)
def test_equals_float64_whatever_the_offset(
    seed: int, offset: float, scale: float, sizes: list[int]
) -> None:
    """Of the samples as float32 has them, whose own rounding can be all of the variance."""
    rng = np.random.default_rng(seed)
    batches = [np.float32(rng.normal(offset, scale, (size, 1))) for size in sizes]
    statistics = merge([(batch, np.ones(len(batch), bool)) for batch in batches], jit=False)
    seen = np.concatenate(batches).astype(np.float64)
    if not len(seen):
        return
    ulp = np.spacing(np.float32(np.abs(seen).max()))
    np.testing.assert_allclose(statistics.mean, seen.mean(axis=0), atol=2 * ulp)
    if seen.std() > 100 * ulp:
        np.testing.assert_allclose(statistics.std, seen.std(axis=0), rtol=1e-4, atol=2 * ulp)


def test_a_billion_samples() -> None:
    """In a million merges of a thousand, against float64; dimensions far from zero, and constant.

    Plain float32 sums would count 1.008 billion and put the standard deviation 0.4 % too low.
    """
    num_merges, kinds, size = 1_000_000, 997, 1000
    rng = np.random.default_rng(0)
    offset = np.array([0.0, 1000.0, -5.0, 1e5, 3.0])
    scale = np.array([1.0, 1.0, 0.1, 1.0, 0.0])
    means = np.float32(offset + scale * rng.normal(size=(kinds, 5)) / np.sqrt(size))
    sums = np.float32(size * scale**2 * rng.uniform(0.9, 1.1, (kinds, 5)))

    @jax.jit
    def merged(means: jax.Array, sums: jax.Array) -> normalizer.RunningStatistics:
        def add(index: jax.Array, statistics: normalizer.RunningStatistics):
            # The last tenth of the samples is of another distribution.
            later = 1.0 + 0.01 * (index >= 0.9 * num_merges)
            kind = index % kinds
            return normalizer.merge(statistics, float(size), means[kind] * later, sums[kind])

        return jax.lax.fori_loop(0, num_merges, add, normalizer.init(5))

    statistics = merged(means, sums)
    index = np.arange(num_merges)
    later = np.float32(1.0) + np.float32(0.01) * (index >= 0.9 * num_merges).astype(np.float32)
    all_means = np.float64(means[index % kinds] * later[:, None])
    mean = all_means.mean(axis=0)
    std = np.sqrt((sums[index % kinds] / size + np.square(all_means - mean)).mean(axis=0))
    assert float(statistics.count) == 1e9
    np.testing.assert_allclose(statistics.mean, mean, rtol=2e-7, atol=1e-9)
    np.testing.assert_allclose(statistics.std, std, rtol=1e-5)


def test_counting_does_not_stop_where_float32_has_gaps() -> None:
    statistics = normalizer.init(1).replace(count=jnp.float32(2.0**24))
    for _ in range(10):
        statistics = normalizer.merge(statistics, jnp.float32(1.0), jnp.ones(1), jnp.zeros(1))
    assert float(statistics.count) + float(statistics.excess[0]) == 2**24 + 10


@settings(max_examples=30, deadline=None)
@given(
    value=st.floats(-1e9, 1e9, width=32, allow_subnormal=False),
    size=st.sampled_from([1, 3, 1000, 30_000]),
)
def test_any_constant_is_left_unscaled(value: float, size: int) -> None:
    constant = (np.full((size, 1), value, np.float32), np.ones(size, bool))
    statistics = merge([constant, constant], jit=False)
    np.testing.assert_allclose(statistics.mean, [value], rtol=1e-6)
    np.testing.assert_array_equal(statistics.std, [1.0])
