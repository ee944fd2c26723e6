"""Algorithms by name, and a user's own."""

from collections.abc import Mapping
from typing import Any

import jax

from ailsrs_jax.data.demonstrations import Demonstrations
from ailsrs_jax.envs.registry import TASKS, short_name
from ailsrs_jax.errors import UserError, did_you_mean
from ailsrs_jax.own_code import blamed_on, is_own, load_own
from ailsrs_jax.trainers.ailsrs import AILSRS
from ailsrs_jax.trainers.ars import ARS, BRS
from ailsrs_jax.trainers.behavior_cloning import BEHAVIOR_CLONING
from ailsrs_jax.trainers.gail import GAIL
from ailsrs_jax.trainers.parts.rollout import Simulator
from ailsrs_jax.trainers.parts.trainer import Algorithm, Trainer
from ailsrs_jax.trainers.trpo import TRPO

ALGORITHMS = {
    "ailsrs": AILSRS,
    "bc": BEHAVIOR_CLONING,
    "gail": GAIL,
    "ars": ARS,
    "brs": BRS,
    "trpo": TRPO,
}

METRICS = ("evaluation_return", "env_steps", "episodes", "diverged")  # that a run needs


def find_algorithm(name: str) -> Algorithm:
    """Return the algorithm called ``name``, or the user's own, ``module:attribute``.

    >>> import ailsrs_jax as ail
    >>> ail.find_algorithm("bc").title
    'BC'

    Raises:
        UserError: there is none.
    """
    if not isinstance(name, str):
        raise UserError("name the algorithm: 'ailsrs', or 'module:attribute' for one of your own")
    if name in ALGORITHMS:
        return ALGORITHMS[name]
    if not is_own(name):
        hint = did_you_mean(name, ALGORITHMS)
        raise UserError(
            f"unknown algorithm '{name}'{hint}: use one of {', '.join(ALGORITHMS)}, or "
            "module:attribute for one of your own"
        )
    algorithm = load_own(name)
    if not isinstance(algorithm, Algorithm):
        kind = type(algorithm).__name__
        raise UserError(f"{name} is of type {kind}: it must be an ailsrs_jax.Algorithm")
    return algorithm


def make_trainer(
    name: str, simulator: Simulator, demonstrations: Demonstrations | None, settings: Any
) -> Trainer:
    """Make the trainer of the algorithm called ``name``; one of the user's is traced to check it.

    Raises:
        UserError: settings and demonstrations do not go together, or the user's code has a mistake.
    """
    algorithm = find_algorithm(name)
    if not is_own(name):
        return algorithm.make(simulator, demonstrations, settings)
    with blamed_on(name, algorithm.make):
        trainer = algorithm.make(simulator, demonstrations, settings)
        state = jax.eval_shape(trainer.init, jax.random.key(0))
        new_state, metrics = jax.eval_shape(trainer.update, state)
        missing = [x for x in ("kept", "iteration") if not hasattr(state, x)]
        missing += [x for x in (*METRICS, algorithm.kept_by) if x not in metrics]
        if missing:
            raise TypeError(f"the state or the metrics of update lack {', '.join(missing)}")
        before, after = (
            jax.tree.map(lambda x: (x.shape, x.dtype), each) for each in (state, new_state)
        )
        if before != after:
            raise TypeError("update changes the shape or type of a part of the state")
    return trainer


def preset_settings(env: str, preset: str, algorithm: str = "ailsrs") -> Any:
    """Return the settings of ``preset`` for a task; those for a task of one's own are general.

    >>> import ailsrs_jax as ail
    >>> ail.preset_settings("hopper", "tuned").num_directions
    16

    Args:
        env: the task, ``Hopper-v5`` or ``hopper``, or any other name for one's own.
        preset: ``tuned`` or ``paper``.
        algorithm: as in :func:`~ailsrs_jax.runs.run.train`.

    Raises:
        UserError: there is no such preset, or no such algorithm.
    """
    env_id = {short_name(env_id): env_id for env_id in TASKS}.get(env, env)
    return find_algorithm(algorithm).preset(env_id, preset)


def changed_settings(
    env_id: str, preset: str, algorithm: str, settings: Mapping[str, Any]
) -> dict[str, Any]:
    """Return those of ``settings`` that differ from the preset, sorted by name.

    Raises:
        UserError: there is no such preset, or no such algorithm.
    """
    values = vars(preset_settings(env_id, preset, algorithm))
    return {
        name: value
        for name, value in sorted(settings.items())
        if name not in values or value != values[name]
    }
