"""Drawing steps from episodes of different lengths, and remembering drawn steps."""

import jax
import jax.numpy as jnp
from flax import struct


def sample_steps(
    key: jax.Array, lengths: jax.Array, num_samples: int
) -> tuple[jax.Array, jax.Array]:
    """Draw steps uniformly, with replacement, from all live steps of episodes.

    Args:
        key: randomness.
        lengths: ``(E,)`` int32, live steps of each episode; an episode of length 0 is never drawn.
        num_samples: how many to draw.

    Returns:
        ``(num_samples,)`` episode indices and ``(num_samples,)`` time indices.
    """
    ends = jnp.cumsum(lengths)
    steps = jax.random.randint(key, (num_samples,), 0, ends[-1])
    episodes = jnp.searchsorted(ends, steps, side="right")
    return episodes, steps - (ends - lengths)[episodes]


class SampleMemory(struct.PyTreeNode):
    """The samples of the last few iterations, one slot each."""

    samples: jax.Array  # (slots, samples per slot, d)
    num_inserted: jax.Array  # () int32, insertions ever made

    def insert(self, samples: jax.Array) -> "SampleMemory":
        """Put ``samples (samples per slot, d)`` in place of the oldest."""
        slot = self.num_inserted % self.samples.shape[0]
        return SampleMemory(self.samples.at[slot].set(samples), self.num_inserted + 1)

    def sample(self, key: jax.Array, num_samples: int) -> jax.Array:
        """Draw ``(num_samples, d)`` uniformly, with replacement, from the filled slots."""
        slots, slot_size, width = self.samples.shape
        filled = jnp.minimum(self.num_inserted, slots)
        indices = jax.random.randint(key, (num_samples,), 0, filled * slot_size)
        return self.samples.reshape(-1, width)[indices]


def empty_memory(slots: int, slot_size: int, width: int) -> SampleMemory:
    """A memory with nothing in it; insert before sampling."""
    return SampleMemory(jnp.zeros((slots, slot_size, width)), jnp.zeros((), jnp.int32))
