"""Refusal, in one line, of package versions that are known to fail in obscure ways."""

from importlib.metadata import version

# On CPUs jax 0.10 deadlocks when two independent batched LAPACK calls of some 900 matrices run in
# one program, as they do in MJX (tests/envs/test_large_batch.py). Versions before 0.9 are untested.
SUPPORTED_JAX = ("0.9.",)


class VersionError(ImportError):
    """A dependency has an unsupported version; the message says which version to install."""


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
