"""A task small enough to learn in seconds: push a point to the origin and keep it there."""

import jax
import jax.numpy as jnp
import numpy as np

from ailsrs_jax.components.policy import LinearPolicy
from ailsrs_jax.data.demonstrations import Demonstrations
from ailsrs_jax.data.policies import SavedLinearPolicy
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


def noise(n: int, p: int, lengths: list[int], env_id: str) -> Demonstrations:
    """Episodes of random observations and actions, each with a return of 1."""
    rng, shape = np.random.default_rng(0), (len(lengths), max(lengths))
    return Demonstrations(
        observations=rng.normal(size=(*shape, n)).astype(np.float32),
        actions=rng.uniform(-1, 1, (*shape, p)).astype(np.float32),
        lengths=np.array(lengths),
        returns=np.ones(len(lengths), np.float32),
        env_id=env_id,
    )


def wide_demonstrations() -> Demonstrations:
    return noise(WIDE_OBSERVATION, WIDE_ACTION, [50, 50], "wide")


def linear_policy(
    weights: np.ndarray, env_id: str = "PointMass", **changes: np.ndarray
) -> SavedLinearPolicy:
    """A policy of observations as they are, with actions from −1 to 1."""
    p, n = weights.shape
    fields = {"mean": np.zeros(n), "std": np.ones(n)}
    fields |= {"action_low": -np.ones(p), "action_high": np.ones(p)}
    return SavedLinearPolicy(weights=weights, env_id=env_id, **(fields | changes))


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
