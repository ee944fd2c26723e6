"""Running mean and standard deviation of the states met so far, from masked batches."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
from flax import struct

# Below this, relative to the magnitude of the mean, a standard deviation in float32 is rounding.
MIN_RELATIVE_STD = 1e-6


class RunningStatistics(struct.PyTreeNode):
    """Moments of a stream of vectors; with no samples yet, mean 0 and standard deviation 1."""

    count: jax.Array  # () float32, number of samples
    mean: jax.Array  # (n,) float32
    sum_of_squares: jax.Array  # (n,) float32, summed squared deviations from the mean

    @property
    def std(self) -> jax.Array:
        """Standard deviation ``(n,)``; 1 for a dimension that has shown no variance."""
        std = jnp.sqrt(self.sum_of_squares / jnp.maximum(self.count, 1.0))
        return jnp.where(std > MIN_RELATIVE_STD * (1.0 + jnp.abs(self.mean)), std, 1.0)


def init(size: int) -> RunningStatistics:
    """Statistics of no samples of ``size`` dimensions."""
    return RunningStatistics(
        count=jnp.zeros(()), mean=jnp.zeros(size), sum_of_squares=jnp.zeros(size)
    )


def update(
    statistics: RunningStatistics,
    samples: jax.Array,
    mask: jax.Array,
    total: Callable[[jax.Array], jax.Array] = lambda part: part,
) -> RunningStatistics:
    """Merge the samples ``(..., n)`` whose ``mask (...)`` is true.

    The batch's own moments are computed in two passes and merged with the parallel formula of
    Chan, Golub and LeVeque (1983), which stays accurate when the mean is far from zero:

        δ = mean_b − mean_a,   mean = mean_a + δ n_b / n,   M2 = M2_a + M2_b + δ² n_a n_b / n

    Where the batch is spread over devices, each with its own ``samples``, ``total`` is what sums
    over all of them.
    """
    samples = samples.reshape(-1, samples.shape[-1])
    mask = mask.reshape(-1, 1)
    batch_count = total(jnp.sum(mask, dtype=jnp.float32))
    batch_mean = total(jnp.sum(samples, axis=0, where=mask)) / jnp.maximum(batch_count, 1.0)
    batch_sum = total(jnp.sum(jnp.square(samples - batch_mean), axis=0, where=mask))

    count = statistics.count + batch_count
    batch_fraction = batch_count / jnp.maximum(count, 1.0)
    shift = batch_mean - statistics.mean
    return RunningStatistics(
        count=count,
        mean=statistics.mean + shift * batch_fraction,
        sum_of_squares=statistics.sum_of_squares
        + batch_sum
        + jnp.square(shift) * statistics.count * batch_fraction,
    )
