"""Rolling out a batch of policies, one episode each, until nobody is alive."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from flax import struct

from ailsrs_jax.components.policy import Policy
from ailsrs_jax.envs import Env, State
from ailsrs_jax.envs.divergence import has_diverged

# Once no episode waits and at most one slot in so many is busy, the rest is simulated in only
# those. Every width is one more copy of the physics to compile, so there are two.
NARROWING = 8

SLICE_LENGTH = 50  # steps of all episodes that are looked at together


class Episodes(struct.PyTreeNode):
    """B episodes of at most T steps; steps after an episode's end are zeros.

    An episode that diverges ends with the last step of which all numbers are finite. What led up
    to that can be as absurd as what followed, so nothing is to be learned from any of its steps.
    """

    observations: jax.Array  # (B, T, n), what the policy saw
    actions: jax.Array  # (B, T, p), what it did, clipped to the actuators' range
    env_rewards: jax.Array  # (B, T), what the environment paid for it; NaN for a step that diverged
    lengths: jax.Array  # (B,) int32, steps until the episode ended
    diverged: jax.Array  # (B,) bool, it ended because the next step was not finite
    slot_steps: jax.Array  # () int32, steps of the slots that simulated it, busy or idle

    @property
    def usable_lengths(self) -> jax.Array:
        """``(B,)`` int32, steps to learn from: none of an episode that diverged."""
        return jnp.where(self.diverged, 0, self.lengths)

    def alive_from(self, first: int) -> jax.Array:
        """``(B, T)`` bool: the step is to be learned from, in an episode from ``first`` on."""
        num_episodes, num_steps, _ = self.observations.shape
        counted = jnp.where(jnp.arange(num_episodes) < first, 0, self.usable_lengths)
        return jnp.arange(num_steps) < counted[:, None]

    @property
    def env_returns(self) -> jax.Array:
        """``(B,)`` undiscounted returns of the environment's reward; NaN where it diverged."""
        return self.env_rewards.sum(axis=1)

    @property
    def env_steps(self) -> jax.Array:
        """``()`` live steps simulated, of all episodes."""
        return self.lengths.sum()

    def sum_over_steps(
        self, function: Callable[[jax.Array, jax.Array, jax.Array], jax.Array], counts: jax.Array
    ) -> jax.Array:
        """``(B,)`` sums of ``function(observations, actions, next_observations)``.

        Over the first ``counts (B,)`` steps of each episode. In slices of time, which bounds the
        memory and stops where the last episode does. What follows an episode's last step is not
        recorded, and is given as zeros.
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
        return jax.lax.fori_loop(0, num_slices, add_slice, jnp.zeros(counts.shape))

    def episodes(self, start: int, stop: int | None = None) -> "Episodes":
        """The episodes ``start`` to ``stop`` of the batch."""
        return Episodes(
            self.observations[start:stop],
            self.actions[start:stop],
            self.env_rewards[start:stop],
            self.lengths[start:stop],
            self.diverged[start:stop],
            self.slot_steps,
        )


def episode_counts(episodes: Episodes) -> dict[str, jax.Array]:
    """Metrics: the numbers of live steps, of episodes, and of those that diverged."""
    return {
        "env_steps": episodes.env_steps,
        "episodes": jnp.array(len(episodes.diverged)),
        "diverged": episodes.diverged.sum(),
    }


class Slots(struct.PyTreeNode):
    """The S simulations that run at the same time."""

    env_state: State  # (S, ...)
    episode: jax.Array  # (S,) int32, which of the B episodes; B in an idle slot
    time: jax.Array  # (S,) int32, steps since the episode began


Carry = tuple[Slots, jax.Array, Episodes]  # with the index of the next episode that waits


def simulate(
    env: Env,
    policies: Policy,
    reset_keys: jax.Array,
    episode_length: int,
    batch_size: int | None = None,
    noise: jax.Array | None = None,
) -> Episodes:
    """Simulate one episode of each policy.

    With ``batch_size`` slots for more episodes than that, a slot whose episode has ended goes on
    with the next one that waits, as an inference server does with its requests, so that few are
    idle while others are still alive; the episodes are the same. The loop ends when the last
    episode does. An episode also ends where it diverges, before the step that is not finite
    (:mod:`~ailsrs_jax.envs.divergence`).

    Under ``jax.vmap`` the new axis is merged into the batch, so that several seeds still are one
    loop with one batch of simulations; XLA's own rule would copy the whole trajectory at every
    step. ``slot_steps`` is then the number of all of them together.

    Args:
        env: a Brax environment without auto-reset; ``done`` ends an episode.
        policies: a batch of B policies.
        reset_keys: ``(B,)`` keys for the initial states.
        episode_length: T, the time limit in environment steps.
        batch_size: S, simulations at a time; by default all B.
        noise: ``(B, T, p)``, added to the actions before they are clipped.
    """

    @jax.custom_batching.custom_vmap
    def merged(policies: Policy, reset_keys: jax.Array, noise: jax.Array | None) -> Episodes:
        return _simulate(env, policies, reset_keys, noise, episode_length, batch_size)

    @merged.def_vmap
    def _of_many(axis_size: int, in_batched: Any, *arguments: Any) -> tuple[Episodes, Any]:
        together = merged(*merge_axes(axis_size, in_batched, arguments))

        def split(x: jax.Array) -> jax.Array:
            return x.reshape(axis_size, -1, *x.shape[1:])

        batch = Episodes(
            observations=split(together.observations),
            actions=split(together.actions),
            env_rewards=split(together.env_rewards),
            lengths=split(together.lengths),
            diverged=split(together.diverged),
            slot_steps=jnp.broadcast_to(together.slot_steps, axis_size),
        )
        return batch, jax.tree.map(lambda _: True, batch)

    result: Episodes = merged(policies, reset_keys, noise)
    return result


def merge_axes(axis_size: int, in_batched: Any, arguments: tuple[Any, ...]) -> Any:
    """The arguments of a ``custom_vmap`` function, its new axis merged into their first one."""

    def merge(batched: bool, x: jax.Array) -> jax.Array:
        x = x if batched else jnp.broadcast_to(x, (axis_size, *x.shape))
        return x.reshape(-1, *x.shape[2:])

    return jax.tree.map(merge, tuple(in_batched), arguments)


def _simulate(
    env: Env,
    policies: Policy,
    reset_keys: jax.Array,
    noise: jax.Array | None,
    episode_length: int,
    batch_size: int | None,
) -> Episodes:
    num_episodes = len(reset_keys)
    num_slots = min(batch_size or num_episodes, num_episodes)
    all_at_once = num_slots == num_episodes
    initial = jax.vmap(env.reset)(reset_keys)
    trajectory = Episodes(
        observations=jnp.zeros((num_episodes, episode_length, *initial.obs.shape[1:])),
        actions=jnp.zeros((num_episodes, episode_length, *policies.action_low.shape[1:])),
        env_rewards=jnp.zeros((num_episodes, episode_length)),
        lengths=jnp.zeros(num_episodes, jnp.int32),
        diverged=jnp.zeros(num_episodes, bool),
        slot_steps=jnp.zeros((), jnp.int32),
    )
    slots = Slots(
        env_state=jax.tree.map(lambda x: x[:num_slots], initial),
        episode=jnp.arange(num_slots),
        time=jnp.zeros(num_slots, jnp.int32),
    )

    def advance(carry: Carry) -> Carry:
        slots, waiting, trajectory = carry
        episode, time = slots.episode, slots.time
        acting = policies
        if not all_at_once:
            # Of an idle slot any policy will do: what comes of it is written nowhere.
            acting = jax.tree.map(lambda x: x.at[episode].get(mode="clip"), policies)
        inputs = [slots.env_state.obs]
        if noise is not None:
            inputs.append(noise.at[episode, time].get(mode="clip"))
        actions = jax.vmap(lambda policy, *inputs: policy(*inputs))(acting, *inputs)
        env_state = jax.vmap(env.step)(slots.env_state, actions)
        diverged = jax.vmap(has_diverged)(slots.env_state, actions, env_state)
        finite_time = jnp.where(diverged, episode_length, time)  # else nowhere

        def record(buffer: jax.Array, values: jax.Array, time: jax.Array) -> jax.Array:
            return buffer.at[episode, time].set(values, mode="drop")

        trajectory = Episodes(
            observations=record(trajectory.observations, slots.env_state.obs, finite_time),
            actions=record(trajectory.actions, actions, finite_time),
            env_rewards=record(
                trajectory.env_rewards, jnp.where(diverged, jnp.nan, env_state.reward), time
            ),
            lengths=trajectory.lengths.at[episode].set(
                jnp.where(diverged, time, time + 1), mode="drop"
            ),
            diverged=trajectory.diverged.at[episode].set(diverged, mode="drop"),
            slot_steps=trajectory.slot_steps + len(episode),
        )

        # Whose episode is over goes on with the next that waits, or is idle if there is none.
        ended = (env_state.done != 0) | diverged | (time + 1 == episode_length)
        over = (episode < num_episodes) & ended
        following = jnp.minimum(waiting + jnp.cumsum(over) - 1, num_episodes)
        episode = jnp.where(over, following, episode)
        if not all_at_once:
            env_state = jax.tree.map(
                lambda new, old: jnp.where(
                    over.reshape(-1, *[1] * (old.ndim - 1)),
                    new.at[following].get(mode="clip"),
                    old,
                ),
                initial,
                env_state,
            )
        idle = (episode == num_episodes).astype(env_state.done.dtype)
        slots = Slots(env_state.replace(done=idle), episode, jnp.where(over, 0, time + 1))
        return slots, jnp.minimum(waiting + jnp.sum(over), num_episodes), trajectory

    def num_busy(carry: Carry) -> jax.Array:
        return jnp.sum(carry[0].episode < num_episodes)

    carry = (slots, jnp.array(num_slots), trajectory)
    if not all_at_once and (narrow := num_slots // NARROWING):
        carry = jax.lax.while_loop(
            lambda carry: (carry[1] < num_episodes) | (num_busy(carry) > narrow), advance, carry
        )
        slots, *rest = carry
        busy_first = jnp.argsort(slots.episode == num_episodes, stable=True)
        carry = (jax.tree.map(lambda x: x[busy_first[:narrow]], slots), *rest)
    *_, trajectory = jax.lax.while_loop(lambda carry: num_busy(carry) > 0, advance, carry)
    return trajectory
