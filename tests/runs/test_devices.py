import os
import subprocess
import sys

import jax
import pytest
from brax.envs.wrappers.training import EpisodeWrapper

from ailsrs_jax.envs.registry import make_env
from ailsrs_jax.runs.devices import CPU_BATCH_SIZE, choose_simulator, compiler_options
from ailsrs_jax.versions import available_cores
from tests.point_mass import PointMass

REPORT = """
import jax
from ailsrs_jax.runs.devices import set_up_jax
set_up_jax()
print(jax.local_device_count(), jax.config.values["jax_compilation_cache_dir"])
"""


def set_up(**environment: str) -> list[str]:
    inherited = {name: x for name, x in os.environ.items() if name != "JAX_COMPILATION_CACHE_DIR"}
    result = subprocess.run(
        [sys.executable, "-c", REPORT],
        env=inherited | environment,
        check=True,
        capture_output=True,
        text=True,
    )
    return result.stdout.split()


def test_every_core_is_a_device_and_programs_are_kept() -> None:
    count, cache = set_up(XDG_CACHE_HOME="/somewhere")
    assert int(count) == available_cores()
    assert cache == "/somewhere/ailsrs_jax/xla"


def test_what_the_user_has_chosen_stays() -> None:
    count, cache = set_up(JAX_NUM_CPU_DEVICES="3", JAX_COMPILATION_CACHE_DIR="/mine")
    assert (count, cache) == ("3", "/mine")
    count, _ = set_up(XLA_FLAGS="--xla_force_host_platform_device_count=5")
    assert count == "5"


def test_all_devices_share_the_episodes() -> None:
    assert jax.local_device_count() == 4  # as tests/conftest.py says
    assert choose_simulator(PointMass()).num_devices == 4
    assert choose_simulator(make_env("hopper", "mjx")).num_devices == 4


def test_the_c_engine_has_all_cores_on_one_device() -> None:
    for env in (make_env("hopper", "mujoco"), EpisodeWrapper(make_env("hopper", "mujoco"), 5, 1)):
        simulator = choose_simulator(env)
        assert (simulator.num_devices, simulator.batch_size) == (1, None)


def test_what_xla_does_not_simulate_is_compiled_fast(monkeypatch: pytest.MonkeyPatch) -> None:
    hopper = make_env("hopper", "mujoco")
    monkeypatch.setenv("XLA_FLAGS", "--xla_backend_optimization_level=0")
    assert compiler_options(hopper) == {}
    monkeypatch.setenv("XLA_FLAGS", "")
    options = compiler_options(hopper)
    assert options["xla_backend_optimization_level"] == "1"
    double = jax.jit(lambda x: 2 * x).lower(1.0).compile(compiler_options=options)
    assert double(3.0) == 6.0
    assert compiler_options(make_env("hopper", "mjx")) == compiler_options(PointMass()) == {}


def test_slots_are_refilled_where_that_saves_something() -> None:
    sizes = {
        (name, physics): choose_simulator(make_env(name, physics)).batch_size
        for name in ("hopper", "halfcheetah")
        for physics in ("mjx", "mujoco")
    }
    assert sizes.pop(("hopper", "mjx")) == CPU_BATCH_SIZE
    assert set(sizes.values()) == {None}
    assert choose_simulator(PointMass()).batch_size == CPU_BATCH_SIZE  # it might end early
    assert choose_simulator(PointMass(), 3).batch_size == 3
