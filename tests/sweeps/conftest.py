"""Fixtures of the tests of sweeps."""

from pathlib import Path

import pytest

from ailsrs_jax.data.demonstrations import Demonstrations, save_demonstrations
from tests.sweeps.toy_sweep import POINT_MASS


@pytest.fixture
def demonstrations(in_tmp_path: Path, point_mass_expert: Demonstrations) -> str:
    """A file with demonstrations of the point mass, in the current directory."""
    save_demonstrations(point_mass_expert.replace(env_id=POINT_MASS), "point_mass.npz")
    return "point_mass.npz"
