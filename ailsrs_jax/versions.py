"""Refuses, in one line, combinations of packages that are known to fail in ways hard to read."""

from importlib.metadata import version

# jax 0.10 waits for ever on CPUs when two independent batched LAPACK calls of some 900 matrices run
# in one program, which MJX does (tests/envs/test_large_batch.py); older ones are not tested.
SUPPORTED_JAX = ("0.9.",)


class VersionError(ImportError):
    """A dependency is of a version that does not work; the message says what to install."""


def require_supported() -> None:
    """Raise VersionError unless JAX is in the tested range and MuJoCo and MJX match."""
    jax, mujoco, mjx = version("jax"), version("mujoco"), version("mujoco-mjx")
    if not jax.startswith(SUPPORTED_JAX):
        raise VersionError(f"ailsrs_jax is not tested with jax {jax}: pip install 'jax>=0.9,<0.10'")
    if mujoco != mjx:
        raise VersionError(
            f"mujoco {mujoco} and mujoco-mjx {mjx} must be the same version: "
            f"pip install mujoco=={mjx}"
        )
