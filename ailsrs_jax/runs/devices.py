"""The devices of a run, and the setup of JAX for them."""

import contextlib
import os

import jax
import numpy as np
from jax.sharding import Mesh

from ailsrs_jax.envs import Env
from ailsrs_jax.envs.physics.mujoco_engine import available_cores
from ailsrs_jax.envs.tasks.mujoco_task import MujocoTask
from ailsrs_jax.files import cache_directory
from ailsrs_jax.trainers.parts.devices import AXIS, ONE_DEVICE, Devices

# Simulations of a CPU core at a time. Larger batches use its vector units better. Smaller ones
# leave fewer cores idle at the end of an iteration, when few episodes are left (measured by
# experiments/packing.py).
CPU_BATCH_SIZE = 48


def set_up_jax() -> None:
    """Make every CPU core a device, and cache compiled programs for later runs.

    Choices that the user has made stay. Programs that call MuJoCo's C engine are not cached,
    because JAX cannot store a callback.
    """
    if jax.config.values["jax_compilation_cache_dir"] is None:
        jax.config.update("jax_compilation_cache_dir", str(cache_directory() / "xla"))
    chosen = "xla_force_host_platform_device_count" in os.environ.get("XLA_FLAGS", "")
    if jax.config.values["jax_num_cpu_devices"] < 0 and not chosen:
        with contextlib.suppress(RuntimeError):  # JAX has already started
            jax.config.update("jax_num_cpu_devices", available_cores())


def choose_devices(env: Env, num_directions: int) -> Devices:
    """Choose the devices of all processes, or as many as can share the directions evenly.

    MuJoCo's C engine uses all cores of a process itself, so each process then has one device.
    """
    if _steps_in_c(env):
        of_each_process = {device.process_index: device for device in reversed(jax.devices())}
        devices = [of_each_process[index] for index in sorted(of_each_process)]
    else:
        devices = jax.devices()
    if jax.process_count() == 1:  # with more, every process has to take part
        while num_directions % len(devices):
            devices = devices[:-1]
    return Devices(Mesh(np.array(devices), (AXIS,))) if len(devices) > 1 else ONE_DEVICE


def choose_batch_size(env: Env) -> int | None:
    """Choose how many simulations a device runs at a time; None for all.

    Batches pay where episodes can end early but a simulation that has ended still costs time: on
    CPU cores with physics in JAX.
    """
    if jax.default_backend() != "cpu":
        return None
    if _steps_in_c(env) or (isinstance(env, MujocoTask) and not env.ends_early):
        return None
    return CPU_BATCH_SIZE


def _steps_in_c(env: Env) -> bool:
    """Tell whether MuJoCo's C engine simulates ``env``, which may be wrapped."""
    inner = getattr(env, "unwrapped", env)
    return isinstance(inner, MujocoTask) and inner.physics.name == "mujoco"
