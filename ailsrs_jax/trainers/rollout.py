"""Rolling out a batch of policies, one episode each, until nobody is alive."""

from typing import Any

import jax
import jax.numpy as jnp
from flax import struct

from ailsrs_jax.components.policy import LinearPolicy
from ailsrs_jax.envs import Env, State


class Rollout(struct.PyTreeNode):
    """B episodes of at most T steps; steps after an episode's end are zeros.

    Time comes first so that the simulation writes one contiguous row per step.
    """

    observations: jax.Array  # (T, B, n), what the policy saw
    actions: jax.Array  # (T, B, p), what it did, clipped to the actuators' range
    env_rewards: jax.Array  # (T, B), what the environment paid for it
    lengths: jax.Array  # (B,) int32, steps until the episode ended, at least 1

    @property
    def alive(self) -> jax.Array:
        """``(T, B)`` bool: the step happened."""
        return jnp.arange(self.observations.shape[0])[:, None] < self.lengths

    @property
    def env_returns(self) -> jax.Array:
        """``(B,)`` undiscounted returns of the environment's reward."""
        return self.env_rewards.sum(axis=0)

    @property
    def env_steps(self) -> jax.Array:
        """``()`` live steps simulated."""
        return self.lengths.sum()

    def episodes(self, start: int, stop: int | None = None) -> "Rollout":
        """The episodes ``start`` to ``stop`` of the batch."""
        return Rollout(
            self.observations[:, start:stop],
            self.actions[:, start:stop],
            self.env_rewards[:, start:stop],
            self.lengths[start:stop],
        )


def action_range(env: Env) -> tuple[jax.Array, jax.Array]:
    """Lowest and highest action ``(p,)``; Brax's environments take actions from −1 to 1."""
    ones = jnp.ones(env.action_size)
    low, high = getattr(env, "action_low", -ones), getattr(env, "action_high", ones)
    return jnp.asarray(low), jnp.asarray(high)


def rollout(
    env: Env, policies: LinearPolicy, reset_keys: jax.Array, episode_length: int
) -> Rollout:
    """Simulate one episode of each policy.

    The loop ends when the last episode does. Under ``jax.vmap`` the new axis is merged into the
    batch, so that several seeds still are one loop with one batch of simulations; XLA's own rule
    would copy the whole trajectory at every step.

    Args:
        env: a Brax environment without auto-reset; ``done`` ends an episode.
        policies: a batch of B policies.
        reset_keys: ``(B,)`` keys for the initial states.
        episode_length: T, the time limit in environment steps.
    """

    @jax.custom_batching.custom_vmap
    def simulate(policies: LinearPolicy, reset_keys: jax.Array) -> Rollout:
        return _simulate(env, policies, reset_keys, episode_length)

    @simulate.def_vmap
    def _merge_axes(
        axis_size: int, in_batched: Any, policies: LinearPolicy, reset_keys: jax.Array
    ) -> tuple[Rollout, Any]:
        def merge(batched: bool, x: jax.Array) -> jax.Array:
            x = x if batched else jnp.broadcast_to(x, (axis_size, *x.shape))
            return x.reshape(-1, *x.shape[2:])

        policies, reset_keys = jax.tree.map(merge, tuple(in_batched), (policies, reset_keys))
        merged = simulate(policies, reset_keys)

        def split(x: jax.Array) -> jax.Array:  # (T, S·B, …) → (S, T, B, …)
            return jnp.moveaxis(x.reshape(x.shape[0], axis_size, -1, *x.shape[2:]), 1, 0)

        trajectories = jax.tree.map(split, merged.replace(lengths=merged.lengths[None]))
        batch = trajectories.replace(lengths=trajectories.lengths[:, 0])
        return batch, jax.tree.map(lambda _: True, batch)

    result: Rollout = simulate(policies, reset_keys)
    return result


def _simulate(
    env: Env, policies: LinearPolicy, reset_keys: jax.Array, episode_length: int
) -> Rollout:
    batch_size = reset_keys.shape[0]
    env_state = jax.vmap(env.reset)(reset_keys)
    trajectory = Rollout(
        observations=jnp.zeros((episode_length, *env_state.obs.shape)),
        actions=jnp.zeros((episode_length, *policies.action_low.shape)),
        env_rewards=jnp.zeros((episode_length, batch_size)),
        lengths=jnp.zeros(batch_size, jnp.int32),
    )

    def anybody_alive(carry: tuple[jax.Array, State, Rollout]) -> jax.Array:
        time, env_state, _ = carry
        return (time < episode_length) & jnp.any(env_state.done == 0)

    def advance(
        carry: tuple[jax.Array, State, Rollout],
    ) -> tuple[jax.Array, State, Rollout]:
        time, env_state, trajectory = carry
        alive = env_state.done == 0
        actions = jax.vmap(LinearPolicy.__call__)(policies, env_state.obs)
        next_env_state = jax.vmap(env.step)(env_state, actions)

        def record(buffer: jax.Array, values: jax.Array) -> jax.Array:
            mask = alive.reshape(-1, *[1] * (values.ndim - 1))
            return buffer.at[time].set(jnp.where(mask, values, 0.0))

        trajectory = Rollout(
            observations=record(trajectory.observations, env_state.obs),
            actions=record(trajectory.actions, actions),
            env_rewards=record(trajectory.env_rewards, next_env_state.reward),
            lengths=trajectory.lengths + alive,
        )
        # An episode that has ended stays ended, whatever the environment says afterwards.
        done = jnp.maximum(env_state.done, next_env_state.done)
        return time + 1, next_env_state.replace(done=done), trajectory

    _, _, trajectory = jax.lax.while_loop(
        anybody_alive, advance, (jnp.zeros((), jnp.int32), env_state, trajectory)
    )
    return trajectory
