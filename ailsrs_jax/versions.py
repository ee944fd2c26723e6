"""Faults of certain package versions and machines: cured, or refused in one line."""

import os
from importlib.metadata import version

SUPPORTED_JAX = ("0.9.", "0.10.", "0.11.")
THREADS = "PJRT_NPROC"  # the environment variable for how many of them JAX has
SCHEDULER = "--xla_cpu_enable_concurrency_optimized_scheduler"


class VersionError(ImportError):
    """A dependency has an unsupported version; the message says which version to install."""


def available_cores() -> int:
    """Return the number of cores that this process may use; a container can restrict them."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def avoid_deadlock() -> None:
    """Set what keeps JAX from deadlocks on CPUs, before it first computes and reads it.

    With one core JAX has one thread. A function on the host that a program calls occupies it, and
    waits for ever for its large arguments, which a thread must copy. So JAX gets two threads.

    In jax 0.10, two independent batched LAPACK calls of some 900 matrices in one program can wait
    for each other for ever, as in MJX (tests/envs/test_large_batch.py). The flag is given to no
    other version, because XLA ends a process with a flag that it does not know.
    """
    if available_cores() == 1:
        os.environ.setdefault(THREADS, "2")
    flags = os.environ.get("XLA_FLAGS", "")
    if version("jax").startswith("0.10.") and SCHEDULER not in flags:
        os.environ["XLA_FLAGS"] = f"{flags} {SCHEDULER}=false".strip()


def require_supported() -> None:
    """Raise VersionError unless JAX is in the tested range and MuJoCo and MJX match."""
    jax, mujoco, mjx = version("jax"), version("mujoco"), version("mujoco-mjx")
    if not jax.startswith(SUPPORTED_JAX):
        raise VersionError(f"ailsrs_jax is not tested with jax {jax}: pip install 'jax>=0.9,<0.12'")
    if mujoco != mjx:
        raise VersionError(
            f"mujoco {mujoco} and mujoco-mjx {mjx} must be the same version: "
            f"pip install mujoco=={mjx}"
        )
