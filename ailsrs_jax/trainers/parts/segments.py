"""Steps of a stochastic policy in environments that go on from one batch to the next."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from flax import struct

from ailsrs_jax.components.policy import MlpPolicy
from ailsrs_jax.envs import Env, State
from ailsrs_jax.envs.divergence import has_diverged
from ailsrs_jax.trainers.parts.rollout import merge_axes


class RunningEnvs(struct.PyTreeNode):
    """S episodes that are under way."""

    env_state: State  # (S, ...)
    time: jax.Array  # (S,) int32, steps since each began


class Steps(struct.PyTreeNode):
    """T consecutive steps of S environments.

    Of an episode that diverges nothing is to be learned, as in
    :class:`Episodes`: in the place of each of its steps there is a copy
    of one of another episode, which is ``over`` there.
    """

    observations: jax.Array  # (T, S, n)
    drawn_actions: jax.Array  # (T, S, p), whose density the policy knows
    actions: jax.Array  # (T, S, p), what the actuators could do of them
    next_observations: jax.Array  # (T, S, n), of the same episode
    env_rewards: jax.Array  # (T, S)
    terminated: jax.Array  # (T, S) bool, the episode ended in a terminal state
    over: jax.Array  # (T, S) bool, it did or reached its time limit
    diverged: jax.Array  # (T, S) bool, the episode diverged there
    copied: jax.Array  # (T, S) bool, the step is a copy of another

    def episode_counts(self) -> dict[str, jax.Array]:
        """Metrics: the numbers of steps, of episodes that ended, and of those that diverged."""
        diverged = self.diverged.sum()
        return {
            "env_steps": jnp.array(self.over.size),
            "episodes": jnp.sum(self.over & ~self.copied) + diverged,
            "diverged": diverged,
        }


def begin(env: Env, key: jax.Array, num_envs: int) -> RunningEnvs:
    """``num_envs`` new episodes."""
    env_state = jax.vmap(env.reset)(jax.random.split(key, num_envs))
    return RunningEnvs(env_state, jnp.zeros(num_envs, jnp.int32))


def collect(
    env: Env,
    policy: MlpPolicy,
    episodes: RunningEnvs,
    key: jax.Array,
    num_steps: int,
    episode_length: int,
) -> tuple[RunningEnvs, Steps]:
    """Go on for ``num_steps`` with actions drawn from the Gaussian ``policy``.

    An episode that is over, after at most ``episode_length`` steps, is followed by a new one.
    """
    num_envs = len(episodes.time)
    shape = (num_envs, *policy.action_std.shape)
    restart = _make_restart(env)

    def advance(episodes: RunningEnvs, key: jax.Array) -> tuple[RunningEnvs, Steps]:
        noise_key, reset_key = jax.random.split(key)
        env_state, time = episodes.env_state, episodes.time + 1
        noise = policy.action_std * jax.random.normal(noise_key, shape)
        drawn_actions = jax.vmap(policy.unclipped)(env_state.obs) + noise
        actions = policy.clip(drawn_actions)
        next_state = jax.vmap(env.step)(env_state, actions)
        diverged = jax.vmap(has_diverged)(env_state, actions, next_state)
        terminated = next_state.done != 0
        over = terminated | diverged | (time == episode_length)
        steps = Steps(
            observations=env_state.obs,
            drawn_actions=drawn_actions,
            actions=actions,
            next_observations=next_state.obs,
            env_rewards=next_state.reward,
            terminated=terminated,
            over=over,
            diverged=diverged,
            copied=diverged,
        )

        next_state = restart(over, jax.random.split(reset_key, num_envs), next_state)
        return RunningEnvs(next_state, jnp.where(over, 0, time)), steps

    episodes, steps = jax.lax.scan(advance, episodes, jax.random.split(key, num_steps))
    return episodes, _replace_diverged(steps)


def _make_restart(env: Env) -> Callable[[jax.Array, jax.Array, State], State]:
    """A function of ``over (S,)``, keys and states that resets the environments that are over.

    Where none is, nothing is computed. Under ``jax.vmap`` the new axis is merged into the
    environments, because there the branches of a ``cond`` would both be computed at every step.
    """

    @jax.custom_batching.custom_vmap
    def restart(over: jax.Array, keys: jax.Array, states: State) -> State:
        def reset() -> State:
            return jax.tree.map(
                lambda new, old: jnp.where(over.reshape(-1, *[1] * (old.ndim - 1)), new, old),
                jax.vmap(env.reset)(keys),
                states,
            )

        return jax.lax.cond(over.any(), reset, lambda: states)

    @restart.def_vmap
    def _of_many(axis_size: int, in_batched: Any, *arguments: Any) -> tuple[State, Any]:
        merged = restart(*merge_axes(axis_size, in_batched, arguments))
        states = jax.tree.map(lambda x: x.reshape(axis_size, -1, *x.shape[1:]), merged)
        return states, jax.tree.map(lambda _: True, states)

    return restart


def _replace_diverged(steps: Steps) -> Steps:
    """Put steps of the other episodes, in turns, in the places of those that diverged."""

    def backwards(
        later: jax.Array, step: tuple[jax.Array, jax.Array]
    ) -> tuple[jax.Array, jax.Array]:
        over, diverged = step
        useless = diverged | (later & ~over)
        return useless, useless

    useless: jax.Array
    nowhere = jnp.zeros(steps.over.shape[1:], bool)
    _, useless = jax.lax.scan(backwards, nowhere, (steps.over, steps.diverged), reverse=True)
    flat = useless.ravel()
    useful_first = jnp.argsort(flat, stable=True)
    turn = (jnp.cumsum(flat) - 1) % jnp.maximum(jnp.sum(~flat), 1)
    source = jnp.where(flat, useful_first[turn], jnp.arange(len(flat)))

    def copy(x: jax.Array) -> jax.Array:
        copied = x.reshape(-1, *x.shape[2:])[source].reshape(x.shape)
        # Where all have diverged there is nothing to copy.
        return jnp.where(flat.all(), jnp.zeros_like(x), copied)

    return jax.tree.map(copy, steps).replace(
        over=steps.over | useless, diverged=steps.diverged, copied=useless
    )
