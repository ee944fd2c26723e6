"""The devices of a run, and the setup of JAX for them."""

import contextlib
import os

import jax
import numpy as np
from jax.sharding import Mesh

from ailsrs_jax.envs import Env
from ailsrs_jax.envs.gymnasium_env import GymnasiumEnv
from ailsrs_jax.envs.tasks.mujoco_task import MujocoTask
from ailsrs_jax.errors import UserError
from ailsrs_jax.files import cache_directory
from ailsrs_jax.trainers.parts.rollout import Simulator
from ailsrs_jax.trainers.parts.sharing import AXIS
from ailsrs_jax.versions import available_cores

# Simulations of a CPU core at a time. Larger batches use its vector units better. Smaller ones
# leave fewer cores idle at the end of an iteration, when few episodes are left (measured by
# experiments/packing.py).
CPU_BATCH_SIZE = 48


def set_up_jax() -> None:
    """Make every CPU core a device, and cache compiled programs for later runs.

    Choices that the user has made stay. Programs that call MuJoCo's C engine are not cached,
    because JAX cannot store a callback.

    Raises:
        UserError: JAX computes in 64 bits.
    """
    if jax.config.values["jax_enable_x64"]:
        raise UserError("jax_enable_x64 is on, and only 32 bits are supported: turn it off")
    if jax.config.values["jax_compilation_cache_dir"] is None:
        jax.config.update("jax_compilation_cache_dir", str(cache_directory() / "xla"))
    chosen = "xla_force_host_platform_device_count" in os.environ.get("XLA_FLAGS", "")
    if jax.config.values["jax_num_cpu_devices"] < 0 and not chosen:
        with contextlib.suppress(RuntimeError):  # JAX has already started
            jax.config.update("jax_num_cpu_devices", available_cores())


def choose_simulator(env: Env, batch_size: int | None = None) -> Simulator:
    """Simulate on all devices of all processes, ``batch_size`` episodes of each at a time.

    What runs whole episodes uses all cores of a process itself, so each process then has one
    device. By default all episodes are simulated at a time. The exception is physics in JAX on CPU
    cores where episodes end early, because there a simulation costs the same after its episode has
    ended.
    """
    devices = jax.devices()
    if _uses_all_cores(env):
        of_each_process = {device.process_index: device for device in reversed(devices)}
        devices = [of_each_process[index] for index in sorted(of_each_process)]
    elif batch_size is None and jax.default_backend() == "cpu":
        ends_early = not isinstance(env, MujocoTask) or env.ends_early
        batch_size = CPU_BATCH_SIZE if ends_early else None
    mesh = Mesh(np.array(devices), (AXIS,)) if len(devices) > 1 else None
    return Simulator(env, mesh, batch_size)


def compiler_options(env: Env) -> dict[str, str | bool]:
    """Return the options with which XLA compiles the iterations of a trainer in ``env``.

    Where XLA does not simulate, its part of the work is small. Compiling fast then saves more than
    the fastest program would: on Hopper, about half of the time until the first iteration. An
    optimisation level that the user has chosen stays.
    """
    level, chosen = "xla_backend_optimization_level", os.environ.get("XLA_FLAGS", "")
    if not _uses_all_cores(env) or jax.default_backend() != "cpu" or level in chosen:
        return {}
    # XLA refuses options that it does not know.
    emitters = {"xla_cpu_use_fusion_emitters": False} if jax.__version_info__ < (0, 11) else {}
    return {level: "1", **emitters}


def _uses_all_cores(env: Env) -> bool:
    """Tell whether MuJoCo's C engine or workers simulate ``env``, which may be wrapped."""
    inner = getattr(env, "unwrapped", env)
    in_c = isinstance(inner, MujocoTask) and inner.physics.name == "mujoco"
    return in_c or isinstance(inner, GymnasiumEnv)
