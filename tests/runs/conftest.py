"""What several tests of runs share."""

from pathlib import Path

import pytest

from ailsrs_jax.data.demonstrations import save_demonstrations
from tests.point_mass import PointMass, point_mass_demonstrations
from tests.sweeps.toy_sweep import POINT_MASS


@pytest.fixture
def demonstrations(in_tmp_path: Path) -> str:
    """A file of the point mass's."""
    recorded = point_mass_demonstrations(PointMass())
    save_demonstrations(recorded.replace(env_id=POINT_MASS), "point_mass.npz")
    return "point_mass.npz"
