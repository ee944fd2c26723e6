"""The plan of a run: a specification that is checked and ready to start."""

import dataclasses
import operator
from typing import Any

import jax
import numpy as np

from ailsrs_jax.data.demonstrations import Demonstrations
from ailsrs_jax.envs.physics import ENGINES
from ailsrs_jax.envs.registry import TASKS, open_env, short_name, takes_physics
from ailsrs_jax.errors import UserError, refusing
from ailsrs_jax.runs.devices import choose_simulator, set_up_jax
from ailsrs_jax.runs.spec import RunSpec
from ailsrs_jax.runs.storage.config import RunConfig, require_seed
from ailsrs_jax.runs.training_data import TrainingData, read_training_data
from ailsrs_jax.trainers.algorithms import (
    changed_settings,
    find_algorithm,
    make_trainer,
    preset_settings,
)
from ailsrs_jax.trainers.parts.rollout import Simulator
from ailsrs_jax.trainers.parts.settings import override
from ailsrs_jax.trainers.parts.trainer import Trainer

ONLY_TO_IMITATE = "demonstrations", "num_trajectories", "draw_from", "subsample", "states_only"


@dataclasses.dataclass(frozen=True)
class Plan:
    """A run that is checked and ready to start."""

    spec: RunSpec  # names and physics resolved, so that its command makes the same run again
    config: RunConfig
    simulator: Simulator
    data: TrainingData
    physics_reason: str  # why this engine, for people to read

    def make_trainer(self) -> Trainer:
        """Make the trainer; see :func:`~ailsrs_jax.trainers.algorithms.make_trainer`."""
        data = self.data
        return self._make_trainer(data.demonstrations if data.infer is None else data.infer())

    def check(self) -> None:
        """Raise UserError if :meth:`make_trainer` would; nothing is simulated."""
        demonstrations = self.data.demonstrations
        if demonstrations is not None and self.data.infer is not None:
            shape = (*demonstrations.alive.shape, self.simulator.env.action_size)
            demonstrations = demonstrations.replace(actions=np.zeros(shape, np.float32))
        jax.eval_shape(lambda: (self._make_trainer(demonstrations), 0)[1])

    def _make_trainer(self, demonstrations: Demonstrations | None) -> Trainer:
        config = self.config
        return make_trainer(config.algorithm, self.simulator, demonstrations, config.settings)


def plan(spec: RunSpec) -> Plan:
    """Check ``spec`` completely, and read its demonstrations, before anything is written.

    Raises:
        UserError: something is wrong.
    """
    set_up_jax()
    spec = _checked(spec)
    env, env_id, engine, reason = open_env(
        spec.env, spec.physics, spec.workers, spec.worker_timeout
    )
    algorithm = find_algorithm(spec.algorithm)
    batch_size = spec.rollout_batch_size
    if batch_size is not None and batch_size < 1:
        raise UserError(f"rollout_batch_size is {batch_size}: it must be at least 1")
    if batch_size is not None and not algorithm.shares_devices:
        raise UserError(
            f"rollout_batch_size is for random search: {spec.algorithm} does not take it"
        )
    preset = preset_settings(env_id, spec.preset, spec.algorithm)
    settings = override(preset, spec.settings)
    data = TrainingData()
    if algorithm.imitates:
        data = read_training_data(spec, env, env_id, engine)
    elif any(getattr(spec, name) != getattr(RunSpec, name) for name in ONLY_TO_IMITATE):
        raise UserError(
            f"{spec.algorithm} learns from the environment's reward: leave out demonstrations, "
            "num_trajectories, draw_from, subsample and states_only"
        )
    limit = data.time_limit or getattr(env, "time_limit", None) or preset.episode_length
    if "episode_length" not in spec.settings:
        settings = override(settings, {"episode_length": limit})
    config = RunConfig(
        env_id=env_id,
        physics=engine,
        seeds=tuple(spec.seeds),
        algorithm=spec.algorithm,
        preset=spec.preset,
        settings=settings,
        num_trajectories=data.num_trajectories,
        source=data.source,
        demonstrations_sha256=data.sha256,
        subsample=data.subsample,
    )
    simulator = choose_simulator(env, batch_size) if algorithm.shares_devices else Simulator(env)
    return Plan(_resolved(spec, config, limit), config, simulator, data, reason)


def _checked(spec: RunSpec) -> RunSpec:
    """Return ``spec`` with Python's own integers, after checking them and ``states_only``."""
    with refusing("seeds are not a list of whole numbers"):
        seeds = [operator.index(seed) for seed in spec.seeds]
    if not seeds or len(set(seeds)) < len(seeds):
        raise UserError(f"seeds are {seeds}: give one or more different seeds")
    for seed in seeds:
        require_seed(seed)
    if type(spec.states_only) is not bool:
        raise UserError(f"states_only is {spec.states_only!r}: it must be True or False")
    numbers: dict[str, Any] = {}
    for name in ("num_trajectories", "draw_from", "subsample", "rollout_batch_size"):
        if (value := getattr(spec, name)) is not None:
            with refusing(f"{name} is {value!r}, not a whole number"):
                numbers[name] = operator.index(value)
    return dataclasses.replace(spec, seeds=seeds, **numbers)


def _resolved(spec: RunSpec, config: RunConfig, default_length: int) -> RunSpec:
    """Replace what depends on this machine, and drop settings that are the preset's anyway."""
    env, physics, env_id = spec.env, spec.physics, config.env_id
    if isinstance(env, str):
        env = short_name(env_id) if env_id in TASKS else env_id
        if config.physics in ENGINES and takes_physics(env_id):
            physics = config.physics
    demonstrations = spec.demonstrations
    if config.source is not None and config.source.kind != "memory":
        demonstrations = config.source.argument
    values = vars(config.settings)
    settings = changed_settings(env_id, spec.preset, spec.algorithm, values)
    settings.pop("episode_length", None)  # its default is not the preset's
    if values["episode_length"] != default_length:
        settings = dict(sorted({**settings, "episode_length": values["episode_length"]}.items()))
    return dataclasses.replace(
        spec,
        env=env,
        demonstrations=demonstrations,
        seeds=config.seeds,
        settings=settings,
        physics=physics,
    )
