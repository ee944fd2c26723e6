"""Running mean and standard deviation of the states seen so far, from masked batches."""

import jax
import jax.numpy as jnp
from flax import struct

# A standard deviation below this fraction of 1 + |mean| is rounding in float32.
MIN_RELATIVE_STD = 1e-6


class RunningStatistics(struct.PyTreeNode):
    """Moments of a stream of vectors; without samples the mean is 0 and the deviation 1."""

    count: jax.Array  # () float32, number of samples
    mean: jax.Array  # (n,) float32
    sum_of_squares: jax.Array  # (n,) float32, summed squared deviations from the mean
    # The part of each number above that its float32 cannot hold (see :func:`merge`).
    excess: tuple[jax.Array, jax.Array, jax.Array]

    @property
    def std(self) -> jax.Array:
        """Standard deviation ``(n,)``; 1 for a dimension that has shown no variance."""
        std = jnp.sqrt(self.sum_of_squares / jnp.maximum(self.count, 1.0))
        return jnp.where(std > MIN_RELATIVE_STD * (1.0 + jnp.abs(self.mean)), std, 1.0)

    def standardize(self, samples: jax.Array) -> jax.Array:
        """Return ``samples (..., n)`` less the mean, in units of the standard deviation."""
        return (samples - self.mean) / self.std


def init(size: int) -> RunningStatistics:
    """Statistics of no samples of ``size`` dimensions."""
    zeros = jnp.zeros(()), jnp.zeros(size), jnp.zeros(size)
    return RunningStatistics(*zeros, excess=zeros)


def update(statistics: RunningStatistics, samples: jax.Array, mask: jax.Array) -> RunningStatistics:
    """Merge the samples ``(..., n)`` whose ``mask (...)`` is true.

    The moments of the batch are computed in several passes, which stays accurate when the mean is
    far from zero: a sum of large numbers rounds, and the sum of their deviations from the mean
    corrects it.
    """
    samples = samples.reshape(-1, samples.shape[-1])
    mask = mask.reshape(-1, 1)
    batch_count = jnp.sum(mask).astype(jnp.float32)
    divisor = jnp.maximum(batch_count, 1.0)
    batch_mean = jnp.sum(samples, axis=0, where=mask) / divisor
    batch_mean += jnp.sum(samples - batch_mean, axis=0, where=mask) / divisor
    batch_sum = jnp.sum(jnp.square(samples - batch_mean), axis=0, where=mask)
    return merge(statistics, batch_count, batch_mean, batch_sum)


def merge(
    statistics: RunningStatistics,
    batch_count: jax.Array,
    batch_mean: jax.Array,
    batch_sum: jax.Array,
) -> RunningStatistics:
    """Merge a batch of known moments, by the formula of Chan, Golub and LeVeque (1983).

        δ = mean_b − mean_a,   mean = mean_a + δ n_b / n,   M2 = M2_a + M2_b + δ² n_a n_b / n

    The additions are Kahan's: the rounding error of one is added in the next. Without it, float32
    would stop counting once a batch is a 10⁷th of the samples before it.
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
    """Return ``number + excess + increment`` as its nearest float32, and the rest."""
    increment = increment + excess
    rounded = number + increment
    return rounded, increment - (rounded - number)
