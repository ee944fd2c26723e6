"""Fixtures for all tests."""

import dataclasses
import os
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import jax
import pytest

from ailsrs_jax import own_code
from ailsrs_jax.data.demonstrations import Demonstrations
from ailsrs_jax.envs import Env
from ailsrs_jax.runs import devices
from ailsrs_jax.trainers.parts.rollout import Simulator
from tests.point_mass import PointMass, point_mass_demonstrations

jax.config.update("jax_num_cpu_devices", 4)  # for the tests of many devices; the first is enough

# All workers, and the processes that they start, share what they compile: many tests train the same
# small program.
CACHE = Path(tempfile.gettempdir()) / f"ailsrs_jax-tests-{os.getuid()}"
os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(CACHE))
os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0.5")
jax.config.update("jax_compilation_cache_dir", os.environ["JAX_COMPILATION_CACHE_DIR"])
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.5)


def pytest_configure(config: pytest.Config) -> None:
    """Fast tests compile much and compute little, so the compiler's work costs more than it saves.

    JAX reads the flags when it first computes; so do the processes that tests start.
    """
    if config.option.markexpr == "not slow":
        flags = ["--xla_backend_optimization_level=0", "--xla_cpu_parallel_codegen_split_count=1"]
        if jax.__version_info__ < (0, 11):  # later ones end the program at an unknown flag
            flags.append("--xla_cpu_use_fusion_emitters=false")
        os.environ["XLA_FLAGS"] = " ".join([*flags, os.environ.get("XLA_FLAGS", "")])


@pytest.fixture(scope="session", autouse=True)
def _one_device() -> Iterator[None]:
    """Each run uses one device, because programs for several compile slowly."""

    def choose(env: Env, batch_size: int | None = None) -> Simulator:
        return dataclasses.replace(devices.choose_simulator(env, batch_size), mesh=None)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("ailsrs_jax.runs.plan.choose_simulator", choose)
        patch.setattr("ailsrs_jax.runs.experts.expert.choose_simulator", choose)
        yield


@pytest.fixture
def many_devices(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each run uses all devices, as outside of tests; training an expert still uses one."""
    monkeypatch.setattr("ailsrs_jax.runs.plan.choose_simulator", devices.choose_simulator)


@pytest.fixture(scope="session")
def point_mass() -> PointMass:
    return PointMass()


@pytest.fixture
def in_tmp_path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """An empty current directory; what is imported from it or allowed is forgotten afterwards."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "datasets"))
    directory = tmp_path / "work"
    directory.mkdir()
    monkeypatch.chdir(directory)
    monkeypatch.setattr(sys, "path", [*sys.path])
    monkeypatch.setattr(own_code, "_allowed", set())
    yield directory
    for name, module in list(sys.modules.items()):
        if str(getattr(module, "__file__", None)).startswith(str(directory)):
            del sys.modules[name]


@pytest.fixture(scope="session")
def point_mass_expert(point_mass: PointMass) -> Demonstrations:
    return point_mass_demonstrations(point_mass)
