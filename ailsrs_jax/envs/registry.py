"""Tasks by name."""

from collections.abc import Callable
from typing import Any

from ailsrs_jax.envs.half_cheetah import HalfCheetah
from ailsrs_jax.envs.hopper import Hopper
from ailsrs_jax.envs.mujoco_task import MujocoTask
from ailsrs_jax.envs.swimmer import Swimmer
from ailsrs_jax.envs.walker2d import Walker2d
from ailsrs_jax.errors import UserError

TASKS: dict[str, Callable[..., MujocoTask]] = {
    "HalfCheetah-v5": HalfCheetah,
    "Hopper-v5": Hopper,
    "Swimmer-v5": Swimmer,
    "Walker2d-v5": Walker2d,
}


def short_name(env_id: str) -> str:
    """``Hopper-v5`` → ``hopper``."""
    return env_id.removesuffix("-v5").lower()


def resolve_env_id(name: str) -> str:
    """Return the Gymnasium id that ``name`` stands for, given as an id or as a short name.

    Raises:
        UserError: there is no such task.
    """
    for env_id in TASKS:
        if name in (env_id, short_name(env_id)):
            return env_id
    known = ", ".join(map(short_name, TASKS))
    raise UserError(f"unknown environment '{name}': use one of {known}")


def make_env(name: str, physics: str = "auto", **flags: Any) -> MujocoTask:
    """Build a task.

    Args:
        name: a Gymnasium id or its short name, ``Hopper-v5`` or ``hopper``.
        physics: ``mjx``, ``mujoco``, or ``auto``: MJX where JAX has an accelerator, else MuJoCo's
            C engine.
        flags: the constructor flags of the Gymnasium task.

    Raises:
        UserError: unknown task, engine, flag or model file.
    """
    env_id = resolve_env_id(name)
    try:
        return TASKS[env_id](physics, **flags)
    except TypeError as error:
        if "unexpected keyword" in str(error):
            raise UserError(f"{env_id}: {str(error).split(') ', 1)[-1]}") from error
        raise
