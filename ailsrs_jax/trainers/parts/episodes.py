"""A batch of simulated episodes."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
from flax import struct
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from ailsrs_jax.components.policy import Policy

COUNTS = ("env_steps", "episodes", "diverged")  # of the metrics
SLICE_LENGTH = 50  # steps of all episodes that are judged together


class Episodes(struct.PyTreeNode):
    """B episodes of at most T steps; steps after an episode's end are zeros.

    An episode that diverges ends with the last step that has only finite numbers. The steps before
    can be as absurd as those after, so no step of the episode is learned from.
    """

    observations: jax.Array  # (B, T, n), what the policy saw
    actions: jax.Array  # (B, T, p), clipped to the actuators' range
    env_rewards: jax.Array  # (B, T) of the environment; NaN for a step that diverged
    lengths: jax.Array  # (B,) int32, steps until the episode ended
    diverged: jax.Array  # (B,) bool, it ended because the next step was not finite
    final_observations: jax.Array  # (B, n), after the last step
    slot_steps: jax.Array  # () int32, steps of the slots that simulated it, busy or idle
    mesh: Mesh | None = struct.field(pytree_node=False, default=None)  # that shares the episodes

    @property
    def usable_lengths(self) -> jax.Array:
        """``(B,)`` int32, steps to learn from; 0 for an episode that diverged."""
        return jnp.where(self.diverged, 0, self.lengths)

    @property
    def usable(self) -> jax.Array:
        """``(B, T)`` bool, the steps to learn from."""
        return jnp.arange(self.observations.shape[1]) < self.usable_lengths[:, None]

    @property
    def env_returns(self) -> jax.Array:
        """``(B,)`` undiscounted returns of the environment's reward; NaN where it diverged."""
        return self.env_rewards.sum(axis=1)

    @property
    def env_steps(self) -> jax.Array:
        """``()`` live steps of all episodes."""
        return self.lengths.sum()

    def counts(self) -> dict[str, jax.Array]:
        """Metrics: the numbers of live steps, of episodes, and of those that diverged."""
        return {
            "env_steps": self.env_steps,
            "episodes": jnp.array(len(self.diverged)),
            "diverged": self.diverged.sum(),
        }

    def evaluated(self) -> dict[str, jax.Array]:
        """Metrics of an evaluation: the means of return and length, and the counts."""
        return {
            "evaluation_return": self.env_returns.mean(),
            "evaluation_length": self.lengths.mean(),
            **self.counts(),
        }

    def first(self, num_episodes: int) -> "Episodes":
        """The first episodes of the batch, on every device."""
        few = jax.tree.map(lambda x: self._everywhere(x[:num_episodes]) if x.ndim else x, self)
        return few.replace(mesh=None)

    def steps_at(self, time: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
        """Observations, actions and next observations ``(B, k, ·)`` at ``time (B, k)`` of each.

        The observation after an episode's last step is not recorded; zeros stand for it.
        """
        following = _at(self.observations, time + 1)
        steps = _at(self.observations, time), _at(self.actions, time), following
        return jax.tree.map(self._everywhere, steps)

    def sum_over_steps(
        self, function: Callable[[jax.Array, jax.Array, jax.Array], jax.Array], counts: jax.Array
    ) -> jax.Array:
        """Sum ``function(observations, actions, next_observations)`` over steps of each episode.

        Of each episode, the first ``counts (B,)`` steps are summed over. Zeros stand for the
        observation after its last step, which is not recorded. Slices of time bound the memory, and
        the loop stops where the last episode does.
        """
        num_steps = self.observations.shape[1]
        slice_length = min(SLICE_LENGTH, num_steps)

        def add_slice(index: jax.Array, totals: jax.Array) -> jax.Array:
            start = jnp.minimum(index * slice_length, num_steps - slice_length)
            time = start + jnp.arange(slice_length)
            values = function(
                jax.lax.dynamic_slice_in_dim(self.observations, start, slice_length, axis=1),
                jax.lax.dynamic_slice_in_dim(self.actions, start, slice_length, axis=1),
                jnp.take(self.observations, time + 1, axis=1, mode="fill", fill_value=0.0),
            )
            counted = (time >= index * slice_length) & (time < counts[:, None])
            return totals + jnp.sum(values, axis=1, where=counted)

        num_slices = -(-counts.max() // slice_length)
        totals = jax.lax.fori_loop(0, num_slices, add_slice, jnp.zeros(counts.shape))
        return self._everywhere(totals)

    def _everywhere(self, array: jax.Array) -> jax.Array:
        """Copy a small result to all devices, so that what is computed from it is not shared."""
        if self.mesh is None:
            return array
        return jax.lax.with_sharding_constraint(array, NamedSharding(self.mesh, PartitionSpec()))


def over_updates(metrics: dict[str, jax.Array]) -> dict[str, jax.Array]:
    """Combine the stacked metrics of several updates: sums of counts, means of the rest."""
    return {name: x.sum() if name in COUNTS else x.mean() for name, x in metrics.items()}


def with_evaluation(
    metrics: dict[str, jax.Array], evaluated: dict[str, jax.Array]
) -> dict[str, jax.Array]:
    """Combine the ``metrics`` of an iteration's updates with those of its evaluation."""
    return evaluated | metrics | {name: metrics[name] + evaluated[name] for name in COUNTS}


def empty_episodes(policies: Policy, observations: jax.Array, episode_length: int) -> Episodes:
    """Episodes of no steps yet, of the policies that see the first ``observations (B, n)``."""
    num_episodes = len(observations)
    return Episodes(
        observations=jnp.zeros((num_episodes, episode_length, *observations.shape[1:])),
        actions=jnp.zeros((num_episodes, episode_length, *policies.action_low.shape[1:])),
        env_rewards=jnp.zeros((num_episodes, episode_length)),
        lengths=jnp.zeros(num_episodes, jnp.int32),
        diverged=jnp.zeros(num_episodes, bool),
        final_observations=observations,
        slot_steps=jnp.zeros((), jnp.int32),
    )


def _at(array: jax.Array, time: jax.Array) -> jax.Array:
    """Entries ``(B, k, ·)`` of ``array (B, T, ·)``; zeros beyond its end."""
    return jnp.take_along_axis(array, time[..., None], axis=1, mode="fill", fill_value=0.0)
