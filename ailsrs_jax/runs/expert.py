"""Training an expert on the environment's reward."""

from pathlib import Path
from typing import Any

import jax
import numpy as np

from ailsrs_jax.data.files import require_writable
from ailsrs_jax.data.policies import SavedPolicy
from ailsrs_jax.envs import Env
from ailsrs_jax.envs.registry import open_env
from ailsrs_jax.runs.config import require_seed
from ailsrs_jax.runs.devices import choose_batch_size, choose_devices, set_up_jax
from ailsrs_jax.runs.iterations import iterate
from ailsrs_jax.runs.presets import expert_settings
from ailsrs_jax.runs.run import Watch, saved_policy
from ailsrs_jax.trainers.ars import Ars
from ailsrs_jax.trainers.settings import override


def train_expert(
    env: Env | str,
    *,
    seed: int = 0,
    physics: str = "auto",
    output: str | Path | None = None,
    watch: Watch | None = None,
    **settings: Any,
) -> SavedPolicy:
    """Train a linear policy on the environment's reward, by augmented random search.

    Args:
        env: the task, ``Hopper-v5`` or ``hopper``, or ``module:attribute`` for one's own; or any
            Brax environment.
        seed: random seed.
        physics: ``auto``, ``mjx`` or ``mujoco``, where the task is given by its name.
        output: the policy file to write; without it nothing is written.
        watch: called after every iteration.
        settings: fields of :class:`~ailsrs_jax.trainers.ars.ArsSettings` to change.

    Returns:
        The best policy met.

    Raises:
        UserError: something handed in is wrong.
    """
    assignments = {name: str(value) for name, value in settings.items()}
    return search_expert(env, seed, physics, assignments, Path(output) if output else None, watch)


def search_expert(
    env: Env | str,
    seed: int,
    physics: str,
    assignments: dict[str, str],
    output: Path | None,
    watch: Watch | None,
) -> SavedPolicy:
    """What :func:`train_expert` does, with settings as text.

    Raises:
        UserError: something handed in is wrong.
    """
    set_up_jax()
    task = open_env(env, physics)
    require_seed(seed)
    settings = override(expert_settings(task.env_id), assignments)
    trainer = Ars(
        task.env,
        settings,
        choose_devices(task.env, settings.num_directions),
        choose_batch_size(task.env),
    )
    if output is not None:
        require_writable(output)
    seeds, env_steps = np.array([seed], np.int32), np.zeros(1, np.int64)
    start = jax.jit(jax.vmap(lambda seed: trainer.init(jax.random.key(seed))))(seeds)
    kept = start.kept
    try:
        for state, report in iterate(trainer.update, start, env_steps, 0, settings.num_iterations):
            kept = state.kept
            if watch is not None:
                watch(report)
    finally:  # also when interrupted: what was found is not lost, and nothing replaced by nothing
        policy = saved_policy(jax.tree.map(lambda x: x[0], kept.policy), task.env_id)
        if output is not None and np.isfinite(kept.score[0]):
            policy.save(output)
    return policy
