"""Train an expert on the environment's reward: a neural policy by Brax, or a linear one."""

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import numpy as np

from ailsrs_jax.components.policy import Policy
from ailsrs_jax.data.formats.policy import require_format
from ailsrs_jax.data.policies import SavedPolicy
from ailsrs_jax.envs import Env
from ailsrs_jax.envs.registry import open_env
from ailsrs_jax.errors import UserError
from ailsrs_jax.files import require_writable
from ailsrs_jax.runs.devices import choose_simulator, compiler_options, set_up_jax
from ailsrs_jax.runs.experts.evolution import EvolutionSettings, train_by_evolution
from ailsrs_jax.runs.experts.ppo import PPO_PRESETS, PpoSettings, train_ppo
from ailsrs_jax.runs.horizon import env_horizon
from ailsrs_jax.runs.iterations import iterate
from ailsrs_jax.runs.storage.config import require_seed
from ailsrs_jax.runs.storage.metrics import IterationReport
from ailsrs_jax.runs.storage.policies import saved_policy
from ailsrs_jax.trainers.algorithms import preset_settings
from ailsrs_jax.trainers.ars import ArsSettings, make_ars
from ailsrs_jax.trainers.parts.settings import override


def train_expert(
    env: Env | str,
    *,
    algorithm: str = "ppo",
    seed: int = 0,
    physics: str = "auto",
    start: SavedPolicy | None = None,
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
        env: the task, ``Hopper-v5`` or ``hopper``; ``module:attribute`` for a task of your own; or
            any Brax environment.
        algorithm: ``ppo`` is Brax's proximal policy optimization of a multilayer perceptron,
            ``es`` its evolution strategy, and ``ars`` augmented random search of a linear policy.
        seed: random seed.
        physics: ``auto``, ``mjx`` or ``mujoco``; only for a task given by its name.
        start: a policy that ``ppo`` has trained, to go on from, perhaps in a changed environment.
        output: a policy file, written whenever a better policy is found; ``es`` writes it once, in
            the end. Without it nothing is written.
        watch: called after every iteration.
        settings: changed fields of the preset, which has the time limit of the environment:
            :class:`~ailsrs_jax.runs.experts.ppo.PpoSettings`,
            :class:`~ailsrs_jax.runs.experts.evolution.EvolutionSettings` or
            :class:`~ailsrs_jax.trainers.ars.ArsSettings`.

    Returns:
        The best policy; with ``es``, the last one.

    Raises:
        UserError: an argument is wrong, most episodes diverged, or no policy had a finite return.
    """
    set_up_jax()
    task = open_env(env, physics)
    limit = {"episode_length": env_horizon(task.env)}
    chosen = override(expert_settings(algorithm, task.env_id), limit | settings)
    require_seed(seed)
    if start is not None and algorithm != "ppo":
        raise UserError(f"{algorithm} starts anew: leave out start")
    if algorithm != "ars" and not hasattr(task.env, "step"):
        raise UserError(
            f"{algorithm} steps all environments together, and those of Gymnasium run whole "
            "episodes: use ars"
        )
    path = Path(output) if output else None
    if path is not None:
        require_format(path)
        require_writable(path)
    best: SavedPolicy | None = None
    best_score = -np.inf

    def offer(policy: Policy, score: float) -> None:
        nonlocal best, best_score
        if score > best_score:  # false if the score is NaN
            saved, best_score = saved_policy(policy, task.env_id), score
            best = dataclasses.replace(saved, episode_length=chosen.episode_length)
            if path is not None:  # at once, so that an interruption does not lose it
                best.save(path)

    def consider(report: IterationReport, policy: Policy, score: float) -> None:
        offer(policy, score)
        if watch is not None:
            watch(report)
        if report.divergence is not None:
            raise report.divergence

    if isinstance(chosen, PpoSettings):
        train_ppo(task.env, chosen, seed, start, consider)
    elif isinstance(chosen, EvolutionSettings):
        offer(*train_by_evolution(task.env, chosen, seed, watch or (lambda _: None)))
    else:
        _search(task.env, chosen, seed, consider)
    if best is None:
        raise UserError("no policy was found: the return was never a finite number")
    return best


def expert_settings(algorithm: str, env_id: str) -> PpoSettings | EvolutionSettings | ArsSettings:
    """Return the settings that :func:`train_expert` starts from.

    Raises:
        UserError: the algorithm is unknown.
    """
    if algorithm == "ppo":
        return PPO_PRESETS.get(env_id, PpoSettings())
    if algorithm == "es":
        return EvolutionSettings()
    if algorithm == "ars":
        return preset_settings(env_id, "tuned", "ars")
    raise UserError(f"unknown algorithm '{algorithm}': use one of ppo, es, ars")


def _search(env: Env, settings: ArsSettings, seed: int, consider: Callable[..., None]) -> None:
    trainer = make_ars(choose_simulator(env), settings)
    seeds, env_steps = np.array([seed], np.int32), np.zeros(1, np.int64)
    place = trainer.simulator.everywhere
    init = jax.vmap(lambda seed: trainer.init(jax.random.key(seed)))
    start = jax.jit(init, out_shardings=place)(seeds)
    for state, report in iterate(
        trainer.update,
        start,
        env_steps,
        0,
        settings.num_iterations,
        place=place,
        compiler_options=compiler_options(env),
    ):
        kept = jax.tree.map(lambda x: x[0], state.kept)
        consider(report, kept.policy, float(kept.score))
