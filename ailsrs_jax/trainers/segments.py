"""Steps of a stochastic policy in environments that go on from one batch to the next."""

import jax
import jax.numpy as jnp
from flax import struct

from ailsrs_jax.components.policy import MlpPolicy
from ailsrs_jax.envs import Env, State


class Episodes(struct.PyTreeNode):
    """S episodes that are under way."""

    env_state: State  # (S, ...)
    time: jax.Array  # (S,) int32, steps since each began


class Steps(struct.PyTreeNode):
    """T consecutive steps of S environments."""

    observations: jax.Array  # (T, S, n)
    drawn_actions: jax.Array  # (T, S, p), whose density the policy knows
    actions: jax.Array  # (T, S, p), what the actuators could do of them
    next_observations: jax.Array  # (T, S, n), of the same episode
    env_rewards: jax.Array  # (T, S)
    terminated: jax.Array  # (T, S) bool, the episode ended in a terminal state
    over: jax.Array  # (T, S) bool, it did or reached its time limit


def begin(env: Env, key: jax.Array, num_envs: int) -> Episodes:
    """``num_envs`` new episodes."""
    env_state = jax.vmap(env.reset)(jax.random.split(key, num_envs))
    return Episodes(env_state, jnp.zeros(num_envs, jnp.int32))


def collect(
    env: Env,
    policy: MlpPolicy,
    episodes: Episodes,
    key: jax.Array,
    num_steps: int,
    episode_length: int,
) -> tuple[Episodes, Steps]:
    """Go on for ``num_steps`` with actions drawn from the Gaussian ``policy``.

    An episode that is over, after at most ``episode_length`` steps, is followed by a new one.
    """
    num_envs = len(episodes.time)
    shape = (num_envs, *policy.action_std.shape)

    def advance(episodes: Episodes, key: jax.Array) -> tuple[Episodes, Steps]:
        noise_key, reset_key = jax.random.split(key)
        env_state, time = episodes.env_state, episodes.time + 1
        noise = policy.action_std * jax.random.normal(noise_key, shape)
        drawn_actions = jax.vmap(policy.unclipped)(env_state.obs) + noise
        actions = policy.clip(drawn_actions)
        next_state = jax.vmap(env.step)(env_state, actions)
        terminated = next_state.done != 0
        over = terminated | (time == episode_length)
        steps = Steps(
            observations=env_state.obs,
            drawn_actions=drawn_actions,
            actions=actions,
            next_observations=next_state.obs,
            env_rewards=next_state.reward,
            terminated=terminated,
            over=over,
        )

        def restart() -> State:
            return jax.tree.map(
                lambda new, old: jnp.where(over.reshape(-1, *[1] * (old.ndim - 1)), new, old),
                begin(env, reset_key, num_envs).env_state,
                next_state,
            )

        next_state = jax.lax.cond(over.any(), restart, lambda: next_state)
        return Episodes(next_state, jnp.where(over, 0, time)), steps

    return jax.lax.scan(advance, episodes, jax.random.split(key, num_steps))
