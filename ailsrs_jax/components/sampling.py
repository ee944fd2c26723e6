"""Draw steps from episodes of different lengths, and remember drawn steps."""

import jax
import jax.numpy as jnp
from flax import struct


def sample_steps(
    key: jax.Array, lengths: jax.Array, num_samples: int
) -> tuple[jax.Array, jax.Array]:
    """Draw steps uniformly, with replacement, from the live steps of episodes of ``lengths (E,)``.

    An episode of length 0 is never drawn. Returns episode and time indices, ``(num_samples,)``.
    """
    ends = jnp.cumsum(lengths)
    steps = jax.random.randint(key, (num_samples,), 0, ends[-1])
    episodes = jnp.searchsorted(ends, steps, side="right")
    return episodes, steps - (ends - lengths)[episodes]


def sample_times(key: jax.Array, lengths: jax.Array, num_each: int) -> jax.Array:
    """Draw ``(B, num_each)`` times of live steps of each episode, uniformly, with replacement.

    All times of an episode without live steps, of ``lengths (B,)``, are 0.
    """
    fractions = jax.random.uniform(key, (len(lengths), num_each))
    time = (fractions * lengths[:, None]).astype(jnp.int32)
    return jnp.minimum(time, jnp.maximum(lengths[:, None] - 1, 0))  # just below 1 can round up


class StepMemory(struct.PyTreeNode):
    """A few steps of each episode of the last few iterations, one slot an iteration."""

    steps: jax.Array  # (slots, 2, N, k, d), drawn uniformly from each episode of N pairs
    lengths: jax.Array  # (slots, 2, N) int32, live steps of each; 0 in a slot not yet filled
    num_inserted: jax.Array  # () int32, insertions ever made

    def insert(self, steps: jax.Array, lengths: jax.Array) -> "StepMemory":
        """Put ``steps (2, N, k, d)`` and ``lengths (2, N)`` in place of the oldest."""
        slot = self.num_inserted % self.steps.shape[0]
        return StepMemory(
            self.steps.at[slot].set(steps),
            self.lengths.at[slot].set(lengths),
            self.num_inserted + 1,
        )

    def sample(self, key: jax.Array, num_samples: int) -> jax.Array:
        """Draw ``(num_samples, d)`` uniformly, with replacement, from all remembered episodes.

        An episode is drawn as often as its live steps are, not as the k remembered ones.
        """
        episode, time = sample_steps(key, self.lengths.ravel(), num_samples)
        slot, sign, pair = jnp.unravel_index(episode, self.lengths.shape)
        # The steps remembered of an episode are independent draws, so it does not matter which.
        return self.steps[slot, sign, pair, time % self.steps.shape[3]]


def empty_memory(slots: int, num_pairs: int, steps_each: int, width: int) -> StepMemory:
    """Return a memory with nothing in it; insert before sampling."""
    return StepMemory(
        steps=jnp.zeros((slots, 2, num_pairs, steps_each, width)),
        lengths=jnp.zeros((slots, 2, num_pairs), jnp.int32),
        num_inserted=jnp.zeros((), jnp.int32),
    )
