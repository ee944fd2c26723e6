"""The formula of docs/scaling.md against XLA's own account of the memory it plans."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ailsrs_jax.trainers.ailsrs import make_ailsrs
from ailsrs_jax.trainers.parts.ailsrs_settings import AilsrsSettings
from tests.point_mass import WIDE_ACTION as ACTIONS
from tests.point_mass import WIDE_OBSERVATION as SIZE
from tests.point_mass import WidePointMass, wide_demonstrations

SETTINGS = AilsrsSettings(episode_length=500)


@pytest.mark.slow
@pytest.mark.parametrize("standardize_with", ["running", "expert"])
def test_trajectories_are_held_once(standardize_with: str) -> None:
    demonstrations = wide_demonstrations()
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

    floats = SIZE + ACTIONS + 1 + (SIZE if standardize_with == "running" else 0)
    of_200_episodes = 4 * 200 * settings.episode_length * floats
    few, of_three_seeds = planned(100, 1), planned(100, 3)
    np.testing.assert_allclose(planned(200, 1) - few, of_200_episodes, rtol=0.1)
    more = planned(200, 3) - of_three_seeds
    np.testing.assert_allclose(more, 3 * of_200_episodes, rtol=0.1)
    assert of_three_seeds < 1.05 * 3 * few  # some buffers serve all seeds
