"""Environments that are accepted, and the messages about others."""

import dataclasses
from collections.abc import Callable
from typing import Any

import gymnasium
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from brax.envs import fast
from brax.envs.wrappers import training
from flax import struct

from ailsrs_jax.components.policy import LinearPolicy
from ailsrs_jax.envs import State
from ailsrs_jax.envs.interface import action_range, env_name, env_sizes, require_env
from ailsrs_jax.envs.registry import make_env
from ailsrs_jax.errors import UserError
from ailsrs_jax.trainers.parts.rollout import simulate
from tests.point_mass import PointMass


def changed(
    reset: Callable[[State], State] = lambda state: state,
    step: Callable[[State], State] = lambda state: state,
    **attributes: Any,
) -> PointMass:
    """A point mass whose states are changed after each reset, or after each step."""

    class Changed(PointMass):
        def reset(self, rng):
            return reset(super().reset(rng))

        def step(self, state, action):
            return step(super().step(state, action))

    for name, value in attributes.items():
        setattr(Changed, name, value)
    return Changed()


@struct.dataclass
class DuckState:
    """A state of its own, like MuJoCo Playground's."""

    data: Any
    obs: jax.Array
    reward: jax.Array
    done: jax.Array


class Duck:
    """An environment that does not derive from Brax's, with sizes set on the instance."""

    def __init__(self, shape: tuple[int, ...] = (3,)) -> None:
        self.observation_size, self.action_size, self.shape = 3, 2, shape

    def reset(self, key):
        return DuckState(key, jax.random.normal(key, self.shape), jnp.zeros(()), jnp.zeros(()))

    def step(self, state, action):
        return state.replace(obs=state.obs + action.sum())


@dataclasses.dataclass
class Unhashable(PointMass):
    mass: float = 1.0


FINE = {
    "point mass": PointMass(),
    "Brax's own": fast.Fast(),
    "ours on the C engine": make_env("swimmer", "mujoco"),
    "limited in time": training.EpisodeWrapper(PointMass(), 10, 1),
    "a duck": Duck(),
    "Python numbers in the first state": changed(lambda state: state.replace(done=0, reward=0)),
    "a range for each action": changed(action_low=-np.ones(1), action_high=np.full(1, 2.0)),
}


@pytest.mark.parametrize("env", FINE.values(), ids=FINE)
def test_accepted(env: Any) -> None:
    require_env(env)
    n, p = env_sizes(env)
    assert (n, p) == (*env.reset(jax.random.key(0)).obs.shape, env.action_size)
    # With more episodes than slots, states from reset and from step are mixed.
    policy = LinearPolicy(jnp.zeros((p, n)), jnp.zeros(n), jnp.ones(n), *action_range(env))
    policies = policy.with_weights(jnp.ones((3, p, n)))
    episodes = simulate(env, policies, jax.random.split(jax.random.key(1), 3), 4, batch_size=2)
    assert episodes.lengths.tolist() == [4, 4, 4]


def test_the_name_of_a_wrapped_environment() -> None:
    assert env_name(training.EpisodeWrapper(PointMass(), 10, 1)) == "PointMass"
    assert env_name(Duck()) == "Duck"


def until_the_field_ends(state: State) -> State:
    return state.replace(done=jnp.zeros(())) if state.obs[0] > 3 else state


REFUSED = {
    "PointMass: this is a class": PointMass,
    "int: this is not a Brax environment: it has no reset, step, action_size": 3,
    "this is of Gymnasium: pass gymnasium:ID, or a function": gymnasium.make("Swimmer-v5"),
    "it has no hash": Unhashable(),
    "PointMass: VmapWrapper makes it a batch": training.VmapWrapper(PointMass(), 4),
    "PointMass: AutoResetWrapper restarts its episodes": training.EpisodeWrapper(
        training.AutoResetWrapper(PointMass()), 10, 1
    ),
    "its observation is a dict": fast.Fast(obs_mode="dict_state"),
    "its observation is float32[2], its observation_size promises 3": changed(observation_size=3),
    "Duck: its observation is float32[4, 3]": Duck((4, 3)),
    "its observation is int32[2]": changed(lambda state: state.replace(obs=jnp.zeros(2, int))),
    "shapes ((1,), ())": changed(lambda state: state.replace(reward=jnp.zeros(1))),
    "changes the shape or type of the state's done": changed(
        step=lambda state: state.replace(done=state.done > 0)
    ),
    "type of the state's metrics['x'], obs": changed(
        step=lambda state: state.replace(obs=state.obs[:1], metrics={"x": state.obs[0]})
    ),
    "JAX cannot trace it: TracerBoolConversionError": changed(step=until_the_field_ends),
    "JAX cannot trace it: AttributeError: 'tuple'": changed(lambda state: (state.obs, {})),
    "its 1 actions go from [0.0] to [0.0]": changed(
        action_low=np.zeros(1), action_high=np.zeros(1)
    ),
    "its 1 actions go from [-inf] to [1.0]": changed(action_low=np.full(1, -np.inf)),
    "its 1 actions go from -2.0 to [1.0]": changed(action_low=-2.0),
}


@pytest.mark.parametrize(("message", "env"), REFUSED.items(), ids=REFUSED)
def test_what_is_no_environment_is_refused(message: str, env: Any) -> None:
    with pytest.raises(UserError) as caught:
        require_env(env)
    assert message in str(caught.value)
