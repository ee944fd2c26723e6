"""Training an expert on the environment's reward."""

import time
from pathlib import Path
from typing import Any

import jax
import numpy as np

from ailsrs_jax.data.files import require_writable
from ailsrs_jax.data.policies import SavedPolicy
from ailsrs_jax.envs import Env
from ailsrs_jax.envs.registry import open_env
from ailsrs_jax.runs.config import require_seed
from ailsrs_jax.runs.presets import expert_settings
from ailsrs_jax.runs.run import Watch, saved_policy
from ailsrs_jax.runs.tracking import IterationReport
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
    task = open_env(env, physics)
    require_seed(seed)
    settings = override(expert_settings(task.env_id), assignments)
    trainer = Ars(task.env, settings)
    if output is not None:
        require_writable(output)
    update = jax.jit(trainer.update)
    state = jax.jit(trainer.init)(jax.random.key(seed))
    env_steps = 0
    try:
        for iteration in range(settings.num_iterations):
            started = time.perf_counter()
            state, device_metrics = update(state)
            metrics = {name: np.asarray(value)[None] for name, value in device_metrics.items()}
            live_steps = int(metrics["env_steps"][0])
            env_steps += live_steps
            if watch is not None:
                speed = live_steps / (time.perf_counter() - started)
                metrics["env_steps"] = np.array([env_steps])
                watch(IterationReport(iteration, settings.num_iterations, metrics, speed))
    finally:  # also when interrupted: what was found is not lost
        policy = saved_policy(state.kept.policy, task.env_id)
        if output is not None:
            policy.save(output)
    return policy
