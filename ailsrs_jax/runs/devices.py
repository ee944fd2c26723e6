"""What a run computes on, and how JAX is set up for it."""

import contextlib
import os
from collections.abc import Iterator, Sequence

import jax
import numpy as np
from jax.experimental import multihost_utils
from jax.sharding import Mesh

from ailsrs_jax.envs import Env
from ailsrs_jax.envs.physics.mujoco_engine import available_cores
from ailsrs_jax.envs.tasks.mujoco_task import MujocoTask
from ailsrs_jax.errors import UserError
from ailsrs_jax.files import cache_directory
from ailsrs_jax.trainers.parts.rollout import AXIS, Simulator

# Simulations of a CPU core at a time. More make better use of its vector units, fewer leave less
# to wait for when the last episodes of an iteration are still alive (experiments/packing.py).
CPU_BATCH_SIZE = 48


def set_up_jax() -> None:
    """Make every CPU core a device, and keep compiled programs for the next run.

    Neither if the user has chosen already. Programs that call MuJoCo's C engine are not kept: JAX
    cannot store a callback.
    """
    if jax.config.values["jax_compilation_cache_dir"] is None:
        jax.config.update("jax_compilation_cache_dir", str(cache_directory() / "xla"))
    chosen = "xla_force_host_platform_device_count" in os.environ.get("XLA_FLAGS", "")
    if jax.config.values["jax_num_cpu_devices"] < 0 and not chosen:
        with contextlib.suppress(RuntimeError):  # JAX has started: too late
            jax.config.update("jax_num_cpu_devices", available_cores())


def join_processes() -> None:
    """Make this one of the processes of a SLURM, Open MPI, Kubernetes or Cloud TPU job.

    Raises:
        UserError: there is no such job around, or its processes do not find one another.
    """
    try:
        jax.distributed.initialize()
    except (ValueError, RuntimeError) as error:
        raise UserError(f"cannot join the processes of a job: {error}") from error


def is_first_process() -> bool:
    """Whether this process writes and prints for all of them."""
    return jax.process_index() == 0


@contextlib.contextmanager
def together(fingerprint: int = 0) -> Iterator[None]:
    """Let the processes of a run go on together, or fail together, where one alone would wait.

    Raises:
        UserError: what was raised inside; or that another process failed there, or that they were
            given different things to do, which ``fingerprint`` tells.
    """
    problem: UserError | None = None
    try:
        yield
    except UserError as error:
        problem = error
    if jax.process_count() > 1:
        mine = np.array([fingerprint, problem is not None])
        prints, failed = multihost_utils.process_allgather(mine).T
        if problem is None and failed.any():
            problem = UserError("it has failed in another process of the run")
        elif problem is None and len(set(prints.tolist())) > 1:
            problem = UserError("the processes have different commands or demonstrations")
    if problem is not None:
        raise problem


def as_the_first_says(numbers: Sequence[int], most: int) -> list[int]:
    """Its ``numbers``, of which there are at most ``most``, none negative."""
    if jax.process_count() == 1:
        return list(numbers)
    mine = np.full(most, -1)
    mine[: len(numbers)] = numbers
    first = multihost_utils.broadcast_one_to_all(mine)
    return [int(number) for number in first if number >= 0]


def anywhere(flag: bool) -> bool:
    """Whether ``flag`` is set in any process of the run."""
    if jax.process_count() == 1:
        return flag
    return bool(multihost_utils.process_allgather(np.array(flag)).any())


def choose_simulator(env: Env, batch_size: int | None = None) -> Simulator:
    """Simulate on all devices of all processes, ``batch_size`` episodes of each at a time.

    MuJoCo's C engine uses all cores of a process by itself, so it gets one device of each process.
    By default all episodes are simulated at a time, except by MJX on CPU cores where episodes end
    early: there every simulation costs the same whether its episode has ended or not.
    """
    devices = jax.devices()
    if _steps_in_c(env):
        of_each_process = {device.process_index: device for device in reversed(devices)}
        devices = [of_each_process[index] for index in sorted(of_each_process)]
    elif batch_size is None and jax.default_backend() == "cpu":
        ends_early = not isinstance(env, MujocoTask) or env.ends_early
        batch_size = CPU_BATCH_SIZE if ends_early else None
    mesh = Mesh(np.array(devices), (AXIS,)) if len(devices) > 1 else None
    return Simulator(env, mesh, batch_size)


def _steps_in_c(env: Env) -> bool:
    """Whether MuJoCo's C engine simulates it, whatever wraps it."""
    inner = getattr(env, "unwrapped", env)
    return isinstance(inner, MujocoTask) and inner.physics.name == "mujoco"
