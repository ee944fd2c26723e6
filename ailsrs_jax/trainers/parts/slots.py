"""Simulate more episodes than fit at a time: a slot that is free takes the next episode."""

import jax
import jax.numpy as jnp
import optax
from flax import struct

from ailsrs_jax.components.policy import Policy
from ailsrs_jax.envs import Env, State
from ailsrs_jax.envs.divergence import has_diverged
from ailsrs_jax.trainers.parts.episodes import Episodes, empty_episodes

# When no episode waits and at most one slot in this many is busy, the rest is simulated in only
# those. Every width is one more copy of the physics to compile, so there are two.
NARROWING = 8


class Slots(struct.PyTreeNode):
    """The S simulations that run at the same time."""

    env_state: State  # (S, ...)
    episode: jax.Array  # (S,) int32, which of the B episodes; B in an idle slot
    time: jax.Array  # (S,) int32, steps since the episode began


Carry = tuple[Slots, jax.Array, Episodes]  # with the index of the next episode that waits


def simulate_in_slots(
    env: Env,
    policies: Policy,
    initial: State,
    noise: jax.Array | None,
    episode_length: int,
    num_slots: int,
) -> Episodes:
    """Simulate B episodes in ``num_slots`` slots, fewer than B; the episodes are the same.

    A slot whose episode has ended goes on with the next one that waits, as an inference server does
    with its requests, so that few slots are idle while others are busy.
    """
    num_episodes = len(initial.obs)
    slots = Slots(
        env_state=jax.tree.map(lambda x: x[:num_slots], initial),
        episode=jnp.arange(num_slots),
        time=jnp.zeros(num_slots, jnp.int32),
    )

    def advance(carry: Carry) -> Carry:
        slots, waiting, episodes = carry
        episode, time = slots.episode, slots.time
        # The steps of an idle slot are written nowhere, so any policy may act in it.
        acting = jax.tree.map(lambda x: x.at[episode].get(mode="clip"), policies)
        inputs = [slots.env_state.obs]
        if noise is not None:
            inputs.append(noise.at[episode, time].get(mode="clip"))
        actions = jax.vmap(lambda policy, *inputs: policy(*inputs))(acting, *inputs)
        after = jax.vmap(env.step)(slots.env_state, actions)
        diverged = jax.vmap(has_diverged)(slots.env_state, actions, after)
        usable_time = jnp.where(diverged, episode_length, time)  # out of range: not written

        def record(buffer: jax.Array, values: jax.Array, time: jax.Array) -> jax.Array:
            return buffer.at[episode, time].set(values, mode="drop")

        rewards = jnp.where(diverged, jnp.nan, after.reward)
        lengths = jnp.where(diverged, time, time + 1)
        episodes = episodes.replace(
            observations=record(episodes.observations, slots.env_state.obs, usable_time),
            actions=record(episodes.actions, actions, usable_time),
            env_rewards=record(episodes.env_rewards, rewards, time),
            lengths=episodes.lengths.at[episode].set(lengths, mode="drop"),
            diverged=episodes.diverged.at[episode].set(diverged, mode="drop"),
            final_observations=episodes.final_observations.at[
                jnp.where(diverged, num_episodes, episode)
            ].set(after.obs, mode="drop"),
            slot_steps=episodes.slot_steps + len(episode),
        )

        ended = (after.done != 0) | diverged | (time + 1 == episode_length)
        over = (episode < num_episodes) & ended
        following = jnp.minimum(waiting + jnp.cumsum(over) - 1, num_episodes)
        episode = jnp.where(over, following, episode)
        fresh = jax.tree.map(lambda x: x.at[following].get(mode="clip"), initial)
        env_state = jax.vmap(optax.tree.where)(over, fresh, after)
        idle = (episode == num_episodes).astype(env_state.done.dtype)
        slots = Slots(env_state.replace(done=idle), episode, jnp.where(over, 0, time + 1))
        return slots, jnp.minimum(waiting + jnp.sum(over), num_episodes), episodes

    def num_busy(carry: Carry) -> jax.Array:
        return jnp.sum(carry[0].episode < num_episodes)

    carry = slots, jnp.array(num_slots), empty_episodes(policies, initial.obs, episode_length)
    if narrow := num_slots // NARROWING:
        carry = jax.lax.while_loop(
            lambda carry: (carry[1] < num_episodes) | (num_busy(carry) > narrow), advance, carry
        )
        slots, *rest = carry
        busy_first = jnp.argsort(slots.episode == num_episodes, stable=True)
        carry = (jax.tree.map(lambda x: x[busy_first[:narrow]], slots), *rest)
    *_, episodes = jax.lax.while_loop(lambda carry: num_busy(carry) > 0, advance, carry)
    return episodes
