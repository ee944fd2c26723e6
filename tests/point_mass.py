"""A task small enough to learn in seconds: push a point to the origin and keep it there."""

import jax
import jax.numpy as jnp
import numpy as np

from ailsrs_jax.components.policy import LinearPolicy
from ailsrs_jax.data.demonstrations import Demonstrations
from ailsrs_jax.envs import Env, State
from ailsrs_jax.trainers.parts.rollout import simulate

TIME_STEP = 0.1
EXPERT_WEIGHTS = np.array([[-0.4, -0.6]], np.float32)  # a damped spring, too weak to saturate
EPISODE_LENGTH = 60
WIDE_OBSERVATION, WIDE_ACTION = 100, 10


class PointMass(Env):
    """Observation [position, velocity], action a force in [−1, 1]; ends beyond ±3."""

    observation_size = 2
    action_size = 1
    backend = "none"

    def reset(self, rng: jax.Array) -> State:
        observation = jax.random.uniform(rng, (2,), minval=-1.0, maxval=1.0)
        return State(None, observation, jnp.zeros(()), jnp.zeros(()))

    def step(self, state: State, action: jax.Array) -> State:
        position, velocity = state.obs
        velocity = velocity + TIME_STEP * action[0]
        position = position + TIME_STEP * velocity
        done = (jnp.abs(position) > 3.0).astype(jnp.float32)
        reward = -jnp.square(position)
        return state.replace(obs=jnp.stack([position, velocity]), reward=reward, done=done)


class WidePointMass(PointMass):
    """Whose observations and actions are as wide as a robot's; the rest of them counts nothing."""

    observation_size = WIDE_OBSERVATION
    action_size = WIDE_ACTION

    def reset(self, rng: jax.Array) -> State:
        return self._widen(super().reset(rng))

    def step(self, state: State, action: jax.Array) -> State:
        return self._widen(super().step(state.replace(obs=state.obs[:2]), action))

    def _widen(self, state: State) -> State:
        return state.replace(obs=jnp.pad(state.obs, (0, WIDE_OBSERVATION - 2)))


def wide_demonstrations() -> Demonstrations:
    """Two episodes of noise."""
    rng = np.random.default_rng(0)
    return Demonstrations(
        observations=rng.normal(size=(2, 50, WIDE_OBSERVATION)).astype(np.float32),
        actions=rng.normal(size=(2, 50, WIDE_ACTION)).astype(np.float32),
        lengths=np.array([50, 50]),
        returns=np.zeros(2, np.float32),
        env_id="wide",
    )


def expert_policy() -> LinearPolicy:
    ones = jnp.ones(1)
    return LinearPolicy(jnp.asarray(EXPERT_WEIGHTS), jnp.zeros(2), jnp.ones(2), -ones, ones)


def point_mass_demonstrations(env: PointMass, num_episodes: int = 8) -> Demonstrations:
    policies = expert_policy().with_weights(jnp.tile(EXPERT_WEIGHTS, (num_episodes, 1, 1)))
    keys = jax.random.split(jax.random.key(0), num_episodes)
    episodes = simulate(env, policies, keys, EPISODE_LENGTH)
    return Demonstrations(
        observations=np.asarray(episodes.observations),
        actions=np.asarray(episodes.actions),
        lengths=np.asarray(episodes.lengths),
        returns=np.asarray(episodes.env_returns),
        env_id="PointMass",
    )
