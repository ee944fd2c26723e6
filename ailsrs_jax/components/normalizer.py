"""Running mean and standard deviation of the states met so far, from masked batches."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
from flax import struct

# Below so many times 1 + |mean|, a standard deviation in float32 is rounding.
MIN_RELATIVE_STD = 1e-6


class RunningStatistics(struct.PyTreeNode):
    """Moments of a stream of vectors; with no samples yet, mean 0 and standard deviation 1."""

    count: jax.Array  # () float32, number of samples
    mean: jax.Array  # (n,) float32
    sum_of_squares: jax.Array  # (n,) float32, summed squared deviations from the mean
    # Of each of these, what is too small beside it to be part of it (see :func:`merge`).
    excess: tuple[jax.Array, jax.Array, jax.Array]

    @property
    def std(self) -> jax.Array:
        """Standard deviation ``(n,)``; 1 for a dimension that has shown no variance."""
        std = jnp.sqrt(self.sum_of_squares / jnp.maximum(self.count, 1.0))
        return jnp.where(std > MIN_RELATIVE_STD * (1.0 + jnp.abs(self.mean)), std, 1.0)


def init(size: int) -> RunningStatistics:
    """Statistics of no samples of ``size`` dimensions."""
    zeros = jnp.zeros(()), jnp.zeros(size), jnp.zeros(size)
    return RunningStatistics(*zeros, excess=zeros)


def update(
    statistics: RunningStatistics,
    samples: jax.Array,
    mask: jax.Array,
    total: Callable[[jax.Array], jax.Array] = lambda part: part,
) -> RunningStatistics:
    """Merge the samples ``(..., n)`` whose ``mask (...)`` is true.

    The batch's own moments are computed in passes of their own, which stays accurate when the mean
    is far from zero: the sum of large numbers rounds, and that of their deviations from the mean
    that it gives says by how much. Where the batch is spread over devices, each with its own
    ``samples``, ``total`` is what sums over all of them.
    """
    samples = samples.reshape(-1, samples.shape[-1])
    mask = mask.reshape(-1, 1)
    batch_count = total(jnp.sum(mask)).astype(jnp.float32)
    divisor = jnp.maximum(batch_count, 1.0)
    batch_mean = total(jnp.sum(samples, axis=0, where=mask)) / divisor
    batch_mean += total(jnp.sum(samples - batch_mean, axis=0, where=mask)) / divisor
    batch_sum = total(jnp.sum(jnp.square(samples - batch_mean), axis=0, where=mask))
    return merge(statistics, batch_count, batch_mean, batch_sum)


def merge(
    statistics: RunningStatistics,
    batch_count: jax.Array,
    batch_mean: jax.Array,
    batch_sum: jax.Array,
) -> RunningStatistics:
    """Merge a batch of known moments, by the formula of Chan, Golub and LeVeque (1983).

        δ = mean_b − mean_a,   mean = mean_a + δ n_b / n,   M2 = M2_a + M2_b + δ² n_a n_b / n

    The additions are Kahan's: what is lost to rounding in one is added in the next. Without it,
    float32 would stop counting, and moving, once a batch is a 10⁷th of what was there before.
    """
    count = statistics.count + batch_count
    batch_fraction = batch_count / jnp.maximum(count, 1.0)
    shift = batch_mean - statistics.mean
    increments = (
        batch_count,
        shift * batch_fraction,
        batch_sum + jnp.square(shift) * statistics.count * batch_fraction,
    )
    moments = statistics.count, statistics.mean, statistics.sum_of_squares
    (count, mean, sum_of_squares), excess = zip(
        *map(_add, moments, statistics.excess, increments), strict=True
    )
    return RunningStatistics(count, mean, sum_of_squares, excess)


def _add(number: jax.Array, excess: jax.Array, increment: jax.Array) -> tuple[jax.Array, jax.Array]:
    """``number + excess + increment`` as its nearest float32, and what that leaves over."""
    increment = increment + excess
    rounded = number + increment
    return rounded, increment - (rounded - number)
