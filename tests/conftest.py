"""Fixtures for all tests."""

import jax
import pytest

from ailsrs_jax.data.demonstrations import Demonstrations
from tests.point_mass import PointMass, point_mass_demonstrations

jax.config.update("jax_num_cpu_devices", 4)  # for the tests of many devices; the first is enough


@pytest.fixture(scope="session")
def point_mass() -> PointMass:
    return PointMass()


@pytest.fixture(scope="session")
def point_mass_expert(point_mass: PointMass) -> Demonstrations:
    return point_mass_demonstrations(point_mass)
