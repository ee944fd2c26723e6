"""Tasks by name."""

import functools
import inspect
from collections.abc import Callable
from typing import Any, NamedTuple

import gymnasium

from ailsrs_jax.envs import Env
from ailsrs_jax.envs.gymnasium_env import PREFIX, WORKER_TIMEOUT, GymnasiumEnv
from ailsrs_jax.envs.interface import env_name, own_env_id, require_env
from ailsrs_jax.envs.physics import choose_engine
from ailsrs_jax.envs.tasks.ant import Ant
from ailsrs_jax.envs.tasks.half_cheetah import HalfCheetah
from ailsrs_jax.envs.tasks.hopper import Hopper
from ailsrs_jax.envs.tasks.humanoid import Humanoid
from ailsrs_jax.envs.tasks.mujoco_task import MujocoTask
from ailsrs_jax.envs.tasks.swimmer import Swimmer
from ailsrs_jax.envs.tasks.walker2d import Walker2d
from ailsrs_jax.errors import UserError, did_you_mean, refusing
from ailsrs_jax.own_code import allow, is_own, load_own, require_allowed

TASKS: dict[str, Callable[..., MujocoTask]] = {
    "Ant-v5": Ant,
    "HalfCheetah-v5": HalfCheetah,
    "Hopper-v5": Hopper,
    "Humanoid-v5": Humanoid,
    "Swimmer-v5": Swimmer,
    "Walker2d-v5": Walker2d,
}

OWN_PHYSICS = "the environment's own"


class OpenEnv(NamedTuple):
    """An environment, and the facts about it that a run records."""

    env: Env
    env_id: str
    engine: str
    reason: str  # why this engine was chosen, for people to read


def short_name(env_id: str) -> str:
    """``Hopper-v5`` → ``hopper``."""
    return env_id.removesuffix("-v5").lower()


def resolve_env_id(name: str) -> str:
    """Return the Gymnasium id that ``name`` stands for.

    ``gymnasium:ID`` and ``module:attribute`` stay as they are.

    Raises:
        UserError: there is no such task.
    """
    for env_id in TASKS:
        if name in (env_id, short_name(env_id)):
            return env_id
    if is_own(name):
        return name
    known = ", ".join(map(short_name, TASKS))
    similar = did_you_mean(name, TASKS if name[:1].isupper() else map(short_name, TASKS))
    raise UserError(
        f"unknown environment '{name}'{similar}: use one of {known}, gymnasium:ID for any other of "
        "Gymnasium, or module:attribute for your own; in Python, pass the environment itself as env"
    )


def make_env(name: str, physics: str = "auto", **flags: Any) -> Env:
    """Make an environment, a ``brax.envs.base.Env``.

    >>> import ailsrs_jax as ail
    >>> env = ail.make_env("hopper", "mujoco", terminate_when_unhealthy=False)
    >>> env.observation_size, env.action_size
    (11, 3)

    Args:
        name: a Gymnasium id or its short name, ``Hopper-v5`` or ``hopper``; or your own task as
            ``module:attribute``, a class or function that returns an environment.
        physics: ``mjx``, ``mujoco``, ``warp``, or ``auto``: MJX where JAX has an accelerator,
            otherwise MuJoCo's C engine. Your own task receives it if it has a parameter
            ``physics``.
        flags: the constructor flags of the task.

    Raises:
        UserError: the task, engine, flag or model file is unknown, or the result is not an
            environment.
    """
    if name.startswith(PREFIX):
        raise UserError(f"{name} has no step and reset in JAX: pass its name to train or evaluate")
    env_id = resolve_env_id(name)
    allow(env_id)
    return _make(env_id, _factory(env_id), physics, **flags)


def open_env(
    env: Env | str | Callable[[], gymnasium.Env],
    physics: str = "auto",
    workers: int | str | None = None,
    worker_timeout: float | None = None,
) -> OpenEnv:
    """Return the environment called ``env``, or ``env`` itself if it is one, after checking it.

    From then on files may name it, too. A name that comes from a file must first pass
    :func:`require_harmless`.

    Args:
        env: a task by name; a Brax environment; or a function that makes one of Gymnasium.
        physics: see :func:`make_env`.
        workers: see :class:`GymnasiumEnv`; only for an environment of Gymnasium.
        worker_timeout: see :class:`GymnasiumEnv`, too.

    Raises:
        UserError: it is unknown, cannot be trained in, or does not let ``physics`` be chosen.
    """
    if isinstance(env, str):
        allow(env)
    if is_gymnasium(env):
        if physics not in ("auto", GymnasiumEnv.backend):
            raise UserError(f"physics '{physics}': an environment of Gymnasium has its own physics")
        name = env.removeprefix(PREFIX) if isinstance(env, str) else env
        timeout = WORKER_TIMEOUT if worker_timeout is None else worker_timeout
        is_made = isinstance(name, GymnasiumEnv)
        make = GymnasiumEnv if type(name).__hash__ is None else _make_gymnasium
        made: Any = name if is_made else make(name, workers, timeout)
        return OpenEnv(made, made.env_id, made.backend, "whole episodes in worker processes")
    for option, given in (("workers", workers), ("worker_timeout", worker_timeout)):
        if given is not None:
            raise UserError(f"{option} is for environments named gymnasium:ID: leave it out")
    if not isinstance(env, str):
        if physics != "auto":
            raise UserError(
                f"physics '{physics}' needs a task by name: an environment has its own physics"
            )
        require_env(env)
        return OpenEnv(env, own_env_id(env) or env_name(env), _engine(env), OWN_PHYSICS)
    env_id, (_, reason) = resolve_env_id(env), choose_engine(physics)
    factory = _factory(env_id)
    if not _takes_physics(factory):
        reason = OWN_PHYSICS
    task = _make_once(env_id, factory, physics)
    return OpenEnv(task, env_id, _engine(task), reason)


def is_gymnasium(env: Any) -> bool:
    """Whether ``env`` is an environment of Gymnasium, its name, or a function that makes it."""
    if isinstance(env, str):
        return env.startswith(PREFIX)
    is_function = callable(env) and not hasattr(env, "reset") and not isinstance(env, type)
    return isinstance(env, GymnasiumEnv) or is_function


def takes_physics(name: str) -> bool:
    """Whether the caller can choose the physics engine of the task ``name``.

    Raises:
        UserError: there is no such task.
    """
    return not is_gymnasium(name) and _takes_physics(_factory(resolve_env_id(name)))


def require_harmless(env_id: str, source: str, option: str = "--env") -> None:
    """Raise UserError unless it is safe to look up and call ``env_id``, which a file names.

    These are safe: this package's tasks, environments that are registered with Gymnasium without a
    module in their name, and what the user has named in this process; see :func:`open_env`.
    """
    registered_id = env_id.removeprefix(PREFIX)
    if is_gymnasium(env_id) and ":" not in registered_id and registered_id in gymnasium.registry:
        return
    require_allowed(env_id, source, option)


def _make(env_id: str, factory: Callable[..., Env], physics: str, **flags: Any) -> Env:
    is_plain = not flags
    if _takes_physics(factory):
        flags["physics"] = physics
    elif physics != "auto":
        raise UserError(f"{env_id} has no parameter physics: leave '{physics}' out")
    if env_id in TASKS:
        unknown = flags.keys() - inspect.signature(factory).parameters
        if unknown:
            raise UserError(f"{env_id} has no flag {', '.join(sorted(unknown))}")
        task: Any = factory(**flags)
        if is_plain:
            task.env_id = env_id  # so that it is the task of this name wherever it is handed in
        return task
    with refusing(env_id):
        env = factory(**flags)
    require_env(env)
    return env


# All policies of a run are evaluated in one environment, which is compiled once. The factory is
# part of the key: a module that was edited and reloaded has a new one under the same name.
_make_once = functools.lru_cache(maxsize=4)(_make)
_make_gymnasium = functools.lru_cache(maxsize=4)(GymnasiumEnv)


def _takes_physics(factory: Callable[..., Env]) -> bool:
    return "physics" in inspect.signature(factory).parameters


def _engine(env: Env) -> str:
    return str(getattr(env, "backend", "jax"))


def _factory(env_id: str) -> Callable[..., Env]:
    """Return the class or function that makes the task."""
    if env_id in TASKS:
        return TASKS[env_id]
    factory = load_own(env_id)
    with refusing(f"cannot call {env_id}"):
        inspect.signature(factory)
    return factory
