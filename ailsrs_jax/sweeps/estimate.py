"""What a sweep will cost, before it runs."""

import dataclasses
import functools
import time
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp

from ailsrs_jax.components.policy import LinearPolicy, repeated
from ailsrs_jax.envs.interface import action_range, env_sizes
from ailsrs_jax.envs.registry import open_env
from ailsrs_jax.sweeps.cells import Cell
from ailsrs_jax.trainers.algorithms import find_algorithm, preset_settings
from ailsrs_jax.trainers.parts.rollout import simulate
from ailsrs_jax.trainers.parts.settings import override, parse

TRIAL_EPISODES, TRIAL_STEPS = 64, 200  # of the measurement of speed


@dataclasses.dataclass(frozen=True)
class CostEstimate:
    """What the cells of an algorithm on a task will cost."""

    algorithm: str
    env_id: str
    engine: str
    num_cells: int
    num_programs: int  # to compile
    env_steps: int  # at most: episodes may end early, and runs too
    memory_bytes: int  # of the largest program's trajectories and memories
    seconds: float | None  # at the speed of physics alone, where that is quickly measured


def estimate(units: Sequence[Sequence[Cell]]) -> list[CostEstimate]:
    """Of ``units`` of cells that are trained together, by algorithm and task."""
    kinds: dict[tuple[str, str, str], list[Sequence[Cell]]] = {}
    for unit in units:
        cell = unit[0]
        kinds.setdefault((cell.algorithm, cell.env_id, cell.engine), []).append(unit)
    estimates = []
    for (algorithm, env_id, engine), mine in kinds.items():
        cells = [cell for unit in mine for cell in unit]
        env_steps = sum(map(estimated_env_steps, cells))
        # MJX takes longer to compile than this is worth.
        speed = _steps_per_second(env_id, cells[0].physics) if engine == "mujoco" else None
        estimates.append(
            CostEstimate(
                algorithm=algorithm,
                env_id=env_id,
                engine=engine,
                num_cells=len(cells),
                num_programs=len(mine),
                env_steps=env_steps,
                memory_bytes=max(sum(map(_memory_bytes, unit)) for unit in mine),
                seconds=None if speed is None else env_steps / speed,
            )
        )
    return estimates


def estimated_env_steps(cell: Cell) -> int:
    """Environment steps that training simulates at most."""
    settings = _settings(cell)
    batches = 0
    if hasattr(settings, "updates_per_iteration"):  # by trust region
        updates = settings.updates_per_iteration * getattr(settings, "policy_steps", 1)
        batches = updates * settings.batch_size
    steps = _num_episodes(cell, settings) * settings.episode_length + batches
    return int(settings.num_iterations * steps)


def _num_episodes(cell: Cell, settings: Any) -> int:
    """Whole episodes in an iteration."""
    if find_algorithm(cell.algorithm).shares_devices:
        return int(2 * settings.num_directions + settings.num_evaluation_episodes)
    kinds = 2 if hasattr(settings, "updates_per_iteration") else 1  # of the mean, and drawn
    return int(kinds * settings.num_evaluation_episodes)


def _memory_bytes(cell: Cell) -> int:
    """The formula of docs/scaling.md, on one device, and the demonstrations."""
    settings, (n, p) = _settings(cell), env_sizes(open_env(cell.env_id, cell.physics).env)
    steps = _num_episodes(cell, settings) * settings.episode_length
    numbers = steps * (n + p + 1)
    if find_algorithm(cell.algorithm).shares_devices:
        numbers += 2 * settings.num_directions * n * p
    running = getattr(settings, "standardize_with", "") == "running"
    running |= getattr(settings, "normalize_observations", False)  # of ARS
    if jax.default_backend() == "cpu" and running:
        numbers += steps * n
    if hasattr(settings, "memory_iterations"):
        policies = 2 * settings.num_directions
        remembered = policies * -(-settings.memory_samples // policies)
        numbers += 3 * settings.memory_iterations * remembered * (n + p)
    if cell.num_trajectories is not None:
        numbers += cell.num_trajectories * settings.episode_length * (n + p)
    return 4 * numbers


def _settings(cell: Cell) -> Any:
    settings = preset_settings(cell.env_id, cell.preset, cell.algorithm)
    return override(settings, parse(settings, cell.settings))


@functools.cache
def _steps_per_second(env_id: str, physics: str) -> float:
    """Of live episodes of a policy that does nothing."""
    env = open_env(env_id, physics).env
    n, p = env_sizes(env)
    still = LinearPolicy(jnp.zeros((p, n)), jnp.zeros(n), jnp.ones(n), *action_range(env))
    policies = repeated(still, TRIAL_EPISODES)
    keys = jax.random.split(jax.random.key(0), TRIAL_EPISODES)
    jitted = jax.jit(lambda keys: simulate(env, policies, keys, TRIAL_STEPS).env_steps)
    compiled = jitted.lower(keys).compile()
    started = time.perf_counter()
    return int(compiled(keys)) / (time.perf_counter() - started)
