"""Steps of a stochastic policy, in environments that run on from one batch to the next."""

from typing import Any

import jax
import jax.numpy as jnp
import optax
from flax import struct

from ailsrs_jax.components.policy import MlpPolicy, repeated
from ailsrs_jax.envs import Env, State
from ailsrs_jax.envs.divergence import has_diverged
from ailsrs_jax.envs.interface import has_own
from ailsrs_jax.envs.physics.base import LARGEST
from ailsrs_jax.trainers.parts.rollout import merge_vmapped_axis, perceptrons_of


class RunningEnvs(struct.PyTreeNode):
    """S environments, each in the middle of an episode."""

    env_state: Any  # (S, ...), the State of a stepped environment, or what its simulator needs
    time: jax.Array  # (S,) int32, steps since each episode began


class Steps(struct.PyTreeNode):
    """T consecutive steps of S environments.

    No step of an episode that diverges is learned from. A copy of a step of another episode, which
    is ``over`` there, stands in its place.
    """

    observations: jax.Array  # (T, S, n)
    drawn_actions: jax.Array  # (T, S, p), before clipping; the policy knows their density
    actions: jax.Array  # (T, S, p), clipped to the actuators' range
    next_observations: jax.Array  # (T, S, n), of the same episode
    env_rewards: jax.Array  # (T, S)
    terminated: jax.Array  # (T, S) bool, the episode ended in a terminal state
    over: jax.Array  # (T, S) bool, it ended, or reached its time limit
    diverged: jax.Array  # (T, S) bool, the episode diverged there
    copied: jax.Array  # (T, S) bool, the step is a copy of another

    def counts(self) -> dict[str, jax.Array]:
        """Metrics: the numbers of steps, of episodes that ended, and of those that diverged."""
        diverged = self.diverged.sum()
        return {
            "env_steps": jnp.array(self.over.size),
            "episodes": jnp.sum(self.over & ~self.copied) + diverged,
            "diverged": diverged,
        }


def begin(env: Any, key: jax.Array, num_envs: int, episode_length: int) -> RunningEnvs:
    """Start ``num_envs`` episodes of at most ``episode_length`` steps."""
    keys = jax.random.split(key, num_envs)
    if has_own(env, "runs_segments"):
        env_state = env.begin_segments(jax.vmap(env.draw_start)(keys), episode_length)
    else:
        env_state = jax.vmap(env.reset)(keys)
    return RunningEnvs(env_state, jnp.zeros(num_envs, jnp.int32))


def collect(
    env: Env,
    policy: MlpPolicy,
    episodes: RunningEnvs,
    key: jax.Array,
    num_steps: int,
    episode_length: int,
) -> tuple[RunningEnvs, Steps]:
    """Make ``num_steps`` steps in each environment, with actions drawn from ``policy``.

    An episode lasts at most ``episode_length`` steps, and a new one follows. MuJoCo's C engine and
    Gymnasium's worker processes make the steps of each environment without a pause; elsewhere all
    are stepped together.
    """
    num_envs = len(episodes.time)
    shape = (num_envs, *policy.action_std.shape)

    def draw(key: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Return the noise of a step, and keys of the episodes that may begin after it."""
        noise_key, reset_key = jax.random.split(key)
        noise = policy.action_std * jax.random.normal(noise_key, shape)
        return noise, jax.random.split(reset_key, num_envs)

    keys = jax.random.split(key, num_steps)
    if has_own(env, "runs_segments"):  # outside of JAX
        noise, reset_keys = jax.vmap(draw)(keys)
        episodes, steps = _run_segments(env, policy, episodes, noise, reset_keys, episode_length)
        return episodes, _replace_diverged(steps)

    # Both branches of a vmapped condition would be computed at every step.
    @merge_vmapped_axis
    def restart(over: jax.Array, keys: jax.Array, states: State) -> State:
        """Reset the environments whose episode is over; compute nothing where none is."""

        def reset() -> State:
            return jax.vmap(optax.tree.where)(over, jax.vmap(env.reset)(keys), states)

        return jax.lax.cond(over.any(), reset, lambda: states)

    def advance(episodes: RunningEnvs, key: jax.Array) -> tuple[RunningEnvs, Steps]:
        noise, reset_keys = draw(key)
        env_state, time = episodes.env_state, episodes.time + 1
        drawn_actions = jax.vmap(policy.unclipped)(env_state.obs) + noise
        actions = policy.clip(drawn_actions)
        next_state = jax.vmap(env.step)(env_state, actions)
        diverged = jax.vmap(has_diverged)(env_state, actions, next_state)
        done = next_state.done != 0
        over = done | diverged | (time == episode_length)
        # Brax's wrappers say that an episode is done at a time limit of theirs, too.
        terminated = done & (next_state.info.get("truncation", 0) == 0)
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
        return RunningEnvs(restart(over, reset_keys, next_state), jnp.where(over, 0, time)), steps

    episodes, steps = jax.lax.scan(advance, episodes, keys)
    return episodes, _replace_diverged(steps)


def _run_segments(
    env: Any,
    policy: MlpPolicy,
    episodes: RunningEnvs,
    noise: jax.Array,
    reset_keys: jax.Array,
    episode_length: int,
) -> tuple[RunningEnvs, Steps]:
    """Let the environment go on by itself; see ``MujocoTask.run_segments``.

    ``noise (T, S, p)`` is added to the actions. With ``reset_keys (T, S)`` episodes begin where
    others have ended.
    """

    @merge_vmapped_axis
    def of_all(policies: MlpPolicy, states: Any, times: Any, keys: Any, noise: Any) -> Any:
        starts = jax.vmap(jax.vmap(env.draw_start))(keys)
        perceptrons = perceptrons_of(policies)
        return env.run_segments(perceptrons, states, times, starts, noise, episode_length)

    policies = repeated(policy, len(episodes.time))
    by_env = jax.tree.map(lambda x: x.swapaxes(0, 1), (reset_keys, noise))
    env_state, time, *of_steps = of_all(policies, episodes.env_state, episodes.time, *by_env)
    segments, rewards = jax.tree.map(lambda x: x.swapaxes(0, 1), tuple(of_steps))
    steps = Steps(
        observations=segments.observations,
        drawn_actions=policy.unclipped(segments.observations) + noise,
        actions=segments.actions,
        next_observations=segments.next_observations,
        env_rewards=rewards,
        terminated=segments.terminated,
        over=segments.over,
        diverged=segments.diverged | ~(jnp.abs(rewards) <= LARGEST),  # NaN compares as false
        copied=segments.diverged,
    )
    return RunningEnvs(env_state, time), steps


def _replace_diverged(steps: Steps) -> Steps:
    """Replace the steps of episodes that diverged by copies of the others, in turns."""

    def throughout(over: jax.Array, diverged: jax.Array) -> jax.Array:
        episode = jnp.cumsum(over) - over  # its number, for each step
        return jnp.zeros_like(diverged).at[episode].max(diverged)[episode]

    useless = jax.vmap(throughout, in_axes=1, out_axes=1)(steps.over, steps.diverged)
    ends = steps.over.at[-1].set(True)
    flat = useless.ravel()
    useful_first = jnp.argsort(flat, stable=True)
    turn = (jnp.cumsum(flat) - 1) % jnp.maximum(jnp.sum(~flat), 1)
    source = jnp.where(flat, useful_first[turn], jnp.arange(len(flat)))

    def copy(x: jax.Array) -> jax.Array:
        copied = x.reshape(-1, *x.shape[2:])[source].reshape(x.shape)
        # If all have diverged there is nothing to copy.
        return jnp.where(flat.all(), jnp.zeros_like(x), copied)

    return jax.tree.map(copy, steps).replace(
        over=steps.over | useless, diverged=useless & ends, copied=useless
    )
