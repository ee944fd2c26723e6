"""Training an expert on the environment's reward: a neural policy by Brax, or a linear one."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import numpy as np

from ailsrs_jax.components.policy import Policy
from ailsrs_jax.data.policies import SavedPolicy, require_format
from ailsrs_jax.envs import Env
from ailsrs_jax.envs.registry import open_env
from ailsrs_jax.errors import UserError
from ailsrs_jax.files import require_writable
from ailsrs_jax.runs.devices import choose_simulator, set_up_jax
from ailsrs_jax.runs.experts.evolution import EvolutionSettings, train_by_evolution
from ailsrs_jax.runs.experts.ppo import PPO_PRESETS, PpoSettings, train_ppo
from ailsrs_jax.runs.iterations import iterate
from ailsrs_jax.runs.storage.config import require_seed
from ailsrs_jax.runs.storage.metrics import IterationReport
from ailsrs_jax.runs.storage.policies import saved_policy
from ailsrs_jax.trainers.algorithms import preset_settings
from ailsrs_jax.trainers.ars import ArsSettings, make_ars
from ailsrs_jax.trainers.parts.settings import override, parse

ALGORITHMS = ("ppo", "es", "ars")


def train_expert(
    env: Env | str,
    *,
    algorithm: str = "ppo",
    seed: int = 0,
    physics: str = "auto",
    output: str | Path | None = None,
    watch: Callable[[IterationReport], None] | None = None,
    **settings: Any,
) -> SavedPolicy:
    """Train a policy on the environment's reward.

    >>> import ailsrs_jax as ail
    >>> from brax.envs import get_environment
    >>> few = {"num_iterations": 2, "num_directions": 2, "num_top_directions": 1}
    >>> expert = ail.train_expert(
    ...     get_environment("fast"), algorithm="ars", episode_length=20, output="expert.npz", **few
    ... )
    >>> expert.env_id
    'Fast'

    Args:
        env: the task, ``Hopper-v5`` or ``hopper``, or ``module:attribute`` for one's own; or any
            Brax environment.
        algorithm: ``ppo``, Brax's proximal policy optimization of a multilayer perceptron;
            ``es``, its evolution strategy; or ``ars``, augmented random search of a linear policy.
        seed: random seed.
        physics: ``auto``, ``mjx`` or ``mujoco``, where the task is given by its name.
        output: the policy file to write, whenever a better policy is found, or the last one of
            ``es``; without it nothing is written.
        watch: called after every iteration.
        settings: fields of :class:`~ailsrs_jax.runs.experts.ppo.PpoSettings`,
            :class:`~ailsrs_jax.runs.experts.evolution.EvolutionSettings` or
            :class:`~ailsrs_jax.trainers.ars.ArsSettings` to change.

    Returns:
        The best policy met; the last one of ``es``.

    Raises:
        UserError: something handed in is wrong, or most episodes diverged.
    """
    assignments = {name: str(value) for name, value in settings.items()}
    path = Path(output) if output else None
    return search_expert(env, seed, physics, assignments, path, watch, algorithm)


def search_expert(
    env: Env | str,
    seed: int,
    physics: str,
    assignments: dict[str, str],
    output: Path | None,
    watch: Callable[[IterationReport], None] | None,
    algorithm: str = "ppo",
) -> SavedPolicy:
    """What :func:`train_expert` does, with settings as text.

    Raises:
        UserError: something handed in is wrong, or no policy was good enough to have a return.
    """
    set_up_jax()
    if algorithm not in ALGORITHMS:
        raise UserError(f"unknown algorithm '{algorithm}': use one of {', '.join(ALGORITHMS)}")
    task = open_env(env, physics)
    require_seed(seed)
    if output is not None:
        require_format(output)
        require_writable(output)
    best: SavedPolicy | None = None
    best_score = -np.inf

    def offer(policy: Policy, score: float) -> None:
        nonlocal best, best_score
        if score > best_score:  # never, if it is NaN
            best, best_score = saved_policy(policy, task.env_id), score
            if output is not None:  # at once: what was found is not lost if this is interrupted
                best.save(output)

    def consider(report: IterationReport, policy: Policy, score: float) -> None:
        offer(policy, score)
        if watch is not None:
            watch(report)
        report.require_most_finite()

    if algorithm == "ppo":
        preset = PPO_PRESETS.get(task.env_id, PpoSettings())
        ppo_settings = override(preset, parse(preset, assignments))
        train_ppo(task.env, ppo_settings, seed, consider)
    elif algorithm == "es":
        es_settings = override(EvolutionSettings(), parse(EvolutionSettings(), assignments))
        offer(*train_by_evolution(task.env, es_settings, seed, watch or (lambda _: None)))
    else:
        tuned = preset_settings(task.env_id, "tuned", "ars")
        ars_settings = override(tuned, parse(tuned, assignments))
        _search(task.env, ars_settings, seed, consider)
    if best is None:
        raise UserError("no policy was found: the return was never a finite number")
    return best


def _search(env: Env, settings: ArsSettings, seed: int, consider: Callable[..., None]) -> None:
    trainer = make_ars(choose_simulator(env), settings)
    seeds, env_steps = np.array([seed], np.int32), np.zeros(1, np.int64)
    place = trainer.simulator.everywhere
    init = jax.vmap(lambda seed: trainer.init(jax.random.key(seed)))
    start = jax.jit(init, out_shardings=place)(seeds)
    num_iterations = settings.num_iterations
    for state, report in iterate(trainer.update, start, env_steps, 0, num_iterations, place=place):
        kept = jax.tree.map(lambda x: x[0], state.kept)
        consider(report, kept.policy, float(kept.score))
