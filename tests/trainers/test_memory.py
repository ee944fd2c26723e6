"""The formula of docs/scaling.md against XLA's own account of the memory it plans."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ailsrs_jax.data.demonstrations import Demonstrations
from ailsrs_jax.envs import State
from ailsrs_jax.trainers.ailsrs import AilsrsSettings, make_ailsrs
from tests.point_mass import PointMass

SIZE, ACTIONS = 100, 10
SETTINGS = AilsrsSettings(episode_length=500)


class WidePointMass(PointMass):
    """Whose observations are as wide as a robot's."""

    observation_size = SIZE
    action_size = ACTIONS

    def reset(self, rng: jax.Array) -> State:
        return self._widen(super().reset(rng))

    def step(self, state: State, action: jax.Array) -> State:
        return self._widen(super().step(state.replace(obs=state.obs[:2]), action))

    def _widen(self, state: State) -> State:
        return state.replace(obs=jnp.pad(state.obs, (0, SIZE - 2)))


@pytest.mark.parametrize("standardize_with", ["running", "expert"])
def test_trajectories_are_held_once(standardize_with: str) -> None:
    rng = np.random.default_rng(0)
    demonstrations = Demonstrations(
        observations=rng.normal(size=(2, 50, SIZE)).astype(np.float32),
        actions=rng.normal(size=(2, 50, ACTIONS)).astype(np.float32),
        lengths=np.array([50, 50]),
        returns=np.zeros(2, np.float32),
        env_id="wide",
    )
    settings = dataclasses.replace(SETTINGS, standardize_with=standardize_with)

    def planned(num_directions: int, num_seeds: int) -> int:
        changes = {"num_directions": num_directions, "num_top_directions": 1}
        changed = dataclasses.replace(settings, **changes)
        trainer = make_ailsrs(WidePointMass(), demonstrations, changed)
        seeds = jax.ShapeDtypeStruct((num_seeds,), jnp.int32)
        state = jax.eval_shape(
            lambda seeds: jax.vmap(trainer.init)(jax.vmap(jax.random.key)(seeds)), seeds
        )
        compiled = jax.jit(jax.vmap(trainer.update)).lower(state).compile()
        return compiled.memory_analysis().temp_size_in_bytes

    few, many, of_three_seeds = planned(100, 1), planned(200, 1), planned(100, 3)
    floats = SIZE + ACTIONS + 1 + (SIZE if standardize_with == "running" else 0)
    np.testing.assert_allclose(many - few, 4 * 200 * settings.episode_length * floats, rtol=0.1)
    np.testing.assert_allclose(of_three_seeds, 3 * few, rtol=0.05)
