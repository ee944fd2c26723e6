"""The cost of a sweep, estimated before it runs."""

import dataclasses
import functools
import time
from collections.abc import Sequence
from typing import Any

import jax

from ailsrs_jax.components.policy import repeated
from ailsrs_jax.envs.interface import env_sizes
from ailsrs_jax.envs.registry import open_env
from ailsrs_jax.runs.iterations import compiled
from ailsrs_jax.runs.policies import still_policy
from ailsrs_jax.sweeps.cells import Cell
from ailsrs_jax.trainers.algorithms import find_algorithm
from ailsrs_jax.trainers.parts.rollout import simulate

TRIAL_EPISODES, TRIAL_STEPS = 64, 200  # for measuring the speed of the physics


@dataclasses.dataclass(frozen=True)
class CostEstimate:
    """The estimated cost of the cells of one algorithm on one task."""

    algorithm: str
    env_id: str
    engine: str
    num_cells: int
    num_programs: int  # to compile
    env_steps: int  # at most, because episodes and runs may end early
    memory_bytes: int  # for the trajectories and the memory of the largest program
    seconds: float | None  # for the physics alone; None if its speed is slow to measure


def estimate(units: Sequence[Sequence[Cell]]) -> list[CostEstimate]:
    """Estimate the cost of ``units`` of cells that are trained together, by algorithm and task."""
    kinds: dict[tuple[str, str, str], list[Sequence[Cell]]] = {}
    for unit in units:
        spec = unit[0].spec
        kinds.setdefault((spec.algorithm, str(spec.env), unit[0].engine), []).append(unit)
    estimates = []
    for (algorithm, env_id, engine), mine in kinds.items():
        cells = [cell for unit in mine for cell in unit]
        env_steps = sum(map(estimated_env_steps, cells))
        # Compiling MJX would take longer than the measurement is worth.
        speed = _steps_per_second(env_id, cells[0].spec.physics) if engine == "mujoco" else None
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
    """Return the maximum number of environment steps in the training of a cell."""
    return int(_settings(cell).num_iterations * _steps_per_iteration(cell))


def _steps_per_iteration(cell: Cell) -> int:
    """Return what the settings say; your own may say nothing, and then it is an episode."""
    settings = _settings(cell)
    return int(getattr(settings, "steps_per_iteration", settings.episode_length))


def _memory_bytes(cell: Cell) -> int:
    """Apply the formula of docs/scaling.md for one device, and add the demonstrations."""
    spec, settings = cell.spec, _settings(cell)
    n, p = env_sizes(open_env(spec.env, spec.physics).env)
    steps = _steps_per_iteration(cell) // getattr(settings, "updates_per_iteration", 1)
    num_policies = getattr(settings, "num_perturbed", 2 * getattr(settings, "num_directions", 0))
    numbers = steps * (n + p + 1) + num_policies * n * p
    running = getattr(settings, "standardize_with", "") == "running"
    running |= getattr(settings, "normalize_observations", False)  # of ARS
    if jax.default_backend() == "cpu" and running:
        numbers += steps * n
    if hasattr(settings, "memory_iterations"):
        remembered = num_policies * -(-settings.memory_samples // num_policies)
        numbers += 3 * settings.memory_iterations * remembered * (n + p)
    if spec.num_trajectories is not None:
        numbers += spec.num_trajectories * settings.episode_length * (n + p)
    return 4 * numbers


def _settings(cell: Cell) -> Any:
    return find_algorithm(cell.spec.algorithm).settings(**cell.all_settings)


@functools.cache
def _steps_per_second(env_id: str, physics: str) -> float:
    """Measure the live steps of episodes with a policy whose actions are zero."""
    env = open_env(env_id, physics).env
    policies = repeated(still_policy(env), TRIAL_EPISODES)
    keys = jax.random.split(jax.random.key(0), TRIAL_EPISODES)
    program, _ = compiled(lambda keys: simulate(env, policies, keys, TRIAL_STEPS).env_steps, keys)
    started = time.perf_counter()
    return int(program(keys)) / (time.perf_counter() - started)
