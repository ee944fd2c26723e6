"""Training an expert on the environment's reward."""

import time
from pathlib import Path

import jax
import numpy as np

from ailsrs_jax.data.files import require_writable
from ailsrs_jax.data.policies import SavedPolicy
from ailsrs_jax.envs.registry import make_env, resolve_env_id
from ailsrs_jax.runs.config import require_seed
from ailsrs_jax.runs.presets import EXPERTS
from ailsrs_jax.runs.run import Watch, saved_policy
from ailsrs_jax.runs.tracking import IterationReport
from ailsrs_jax.trainers.ars import Ars
from ailsrs_jax.trainers.settings import override


def train_expert(
    env: str,
    seed: int,
    physics: str,
    assignments: dict[str, str],
    output: Path,
    watch: Watch | None = None,
) -> SavedPolicy:
    """Train by augmented random search and write the best policy met to ``output``.

    Raises:
        UserError: unknown environment, physics or setting, or ``output`` cannot be written.
    """
    env_id = resolve_env_id(env)
    require_seed(seed)
    settings = override(EXPERTS[env_id], assignments)
    trainer = Ars(make_env(env_id, physics), settings)
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
        policy = saved_policy(state.kept.policy, env_id)
        policy.save(output)
    return policy
