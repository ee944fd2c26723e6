from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ailsrs_jax.data.demonstrations import Demonstrations
from ailsrs_jax.errors import UserError
from ailsrs_jax.runs.iterations import iterate
from ailsrs_jax.trainers.ailsrs import make_ailsrs
from ailsrs_jax.trainers.ars import ArsSettings, make_ars
from ailsrs_jax.trainers.gail import GailSettings, make_gail
from ailsrs_jax.trainers.parts.ailsrs_settings import AilsrsSettings
from ailsrs_jax.trainers.trpo import TrpoSettings, make_trpo
from tests.point_mass import PointMass


def test_steps_are_counted_beyond_32_bits() -> None:
    steps = jnp.array([2**31 - 1, 7])

    def update(state: jax.Array) -> tuple[jax.Array, dict[str, jax.Array]]:
        return state, {"env_steps": state}

    start = np.array([2**40, 0])
    totals = [
        report.metrics["env_steps"].tolist() for _, report in iterate(update, steps, start, 0, 3)
    ]
    assert totals == [[2**40 + i * (2**31 - 1), i * 7] for i in (1, 2, 3)]


@pytest.mark.parametrize("name", ["ailsrs", "ars", "gail", "trpo"])
def test_more_steps_than_an_iteration_can_count_are_refused(
    name: str, point_mass: PointMass, point_mass_expert: Demonstrations
) -> None:
    long: dict[str, Any] = {"episode_length": 2**20, "num_evaluation_episodes": 2048}
    makers = {
        "ailsrs": lambda: make_ailsrs(point_mass, point_mass_expert, AilsrsSettings(**long)),
        "ars": lambda: make_ars(point_mass, ArsSettings(num_directions=512, **long)),
        "gail": lambda: make_gail(point_mass, point_mass_expert, GailSettings(**long)),
        "trpo": lambda: make_trpo(point_mass, TrpoSettings(**long)),
    }
    with pytest.raises(UserError, match=r"counted in 32 bits, below 2\^31"):
        makers[name]()
