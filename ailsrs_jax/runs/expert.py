"""Training an expert on the environment's reward."""

from pathlib import Path

import jax
import numpy as np

from ailsrs_jax.data.files import require_writable
from ailsrs_jax.data.policies import SavedPolicy
from ailsrs_jax.envs.registry import make_env, resolve_env_id
from ailsrs_jax.runs.config import require_seed
from ailsrs_jax.runs.devices import choose_batch_size, choose_devices, set_up_jax
from ailsrs_jax.runs.iterations import iterate
from ailsrs_jax.runs.presets import EXPERTS
from ailsrs_jax.runs.run import Watch, saved_policy
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
    set_up_jax()
    task = make_env(env_id, physics)
    trainer = Ars(
        task, settings, choose_devices(task, settings.num_directions), choose_batch_size(task)
    )
    require_writable(output)
    seeds, env_steps = np.array([seed], np.int32), np.zeros(1, np.int64)
    start = jax.jit(jax.vmap(lambda seed: trainer.init(jax.random.key(seed))))(seeds)
    kept = start.kept
    try:
        for state, report in iterate(trainer.update, start, env_steps, 0, settings.num_iterations):
            kept = state.kept
            if watch is not None:
                watch(report)
    finally:  # also when interrupted: what was found is not lost
        policy = saved_policy(jax.tree.map(lambda x: x[0], kept.policy), env_id)
        policy.save(output)
    return policy
