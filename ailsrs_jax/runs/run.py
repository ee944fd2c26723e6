"""One run: several seeds of an algorithm on one task, from demonstrations to saved policies."""

import dataclasses
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import jax
import numpy as np

from ailsrs_jax.data.demonstrations import Demonstrations
from ailsrs_jax.data.policies import SavedPolicy
from ailsrs_jax.envs import Env
from ailsrs_jax.envs.registry import open_env
from ailsrs_jax.errors import UserError
from ailsrs_jax.runs.devices import (
    anywhere,
    choose_batch_size,
    choose_devices,
    is_first_process,
    set_up_jax,
    together,
)
from ailsrs_jax.runs.iterations import iterate
from ailsrs_jax.runs.policies import kept_policies
from ailsrs_jax.runs.storage.config import RunConfig, content_hash, require_seed
from ailsrs_jax.runs.storage.directory import RunDirectory, claimed
from ailsrs_jax.runs.storage.metrics import IterationReport
from ailsrs_jax.runs.storage.tracked import tracked
from ailsrs_jax.runs.storage.trackers import require_tracker
from ailsrs_jax.runs.training_data import find_demonstrations, require_fit
from ailsrs_jax.trainers.algorithms import Algorithm, find_algorithm, make_trainer
from ailsrs_jax.trainers.parts.devices import ONE_DEVICE, Devices
from ailsrs_jax.trainers.parts.settings import override, parse
from ailsrs_jax.trainers.parts.trainer import Trainer
from ailsrs_jax.trainers.presets import preset_settings

CHECKPOINT_EVERY = 10  # iterations

Watch = Callable[[IterationReport], None]


@dataclasses.dataclass(frozen=True)
class Plan:
    """A run that is checked and ready to start."""

    config: RunConfig
    env: Env
    demonstrations: Demonstrations | None
    physics_reason: str
    devices: Devices
    rollout_batch_size: int | None  # simulations of a device at a time; None for all

    @property
    def algorithm(self) -> Algorithm:
        """What trains."""
        return find_algorithm(self.config.algorithm)

    def make_trainer(self) -> Trainer:
        """The trainer; see :func:`~ailsrs_jax.trainers.algorithms.make_trainer`."""
        return make_trainer(
            self.algorithm,
            self.env,
            self.demonstrations,
            self.config.settings,
            self.devices,
            self.rollout_batch_size,
        )


@dataclasses.dataclass(frozen=True)
class Result:
    """What a run leaves; :func:`train` returns it."""

    config: RunConfig
    policies: dict[int, SavedPolicy]  #: the kept policy of each seed
    kept_iterations: dict[int, int]  #: when each was found
    expert_returns: np.ndarray | None  #: of the demonstrations, where there are any


def train(
    env: Env | str,
    demonstrations: str | Path | Demonstrations | None = None,
    *,
    algorithm: str = "ailsrs",
    num_trajectories: int | None = None,
    subsample: int = 1,
    seeds: Sequence[int] = (0,),
    preset: str = "tuned",
    physics: str = "auto",
    output: str | Path | None = None,
    resume: bool = False,
    checkpoint_every: int = CHECKPOINT_EVERY,
    rollout_batch_size: int | None = None,
    track: str | None = None,
    watch: Watch | None = None,
    **settings: Any,
) -> Result:
    """Train a policy to imitate demonstrations, or on the environment's reward.

    >>> import ailsrs_jax as ail
    >>> short = {"num_iterations": 2, "num_directions": 8, "episode_length": 100}
    >>> run = ail.train("swimmer", num_trajectories=2, seeds=[0, 1], **short)
    >>> run.policies[1](8 * [0.0]).shape
    (2,)

    Args:
        env: the task, ``Hopper-v5`` or ``hopper``, or ``module:attribute`` for one's own; or any
            Brax environment.
        demonstrations: a ``.npz`` file, ``minari:DATASET_ID``, a directory of the imitation
            library's, or demonstrations in memory; without any, those of the expert that ships with
            the package, and with ``expert:paper`` of one whose return is that of the paper's.
        algorithm: ``ailsrs``, ``bc`` or ``gail``, which imitate; or ``ars``, ``brs`` or ``trpo``,
            which learn from the environment's reward.
        num_trajectories: use the first so many; by default 10 of the shipped expert, else all.
        subsample: train on every k-th of their steps only.
        seeds: all are trained together, as one batched program.
        preset: ``tuned`` or ``paper``.
        physics: ``auto``, ``mjx`` or ``mujoco``, where the task is given by its name.
        output: a run directory to write; without it nothing is written.
        resume: go on from the newest checkpoint in ``output``.
        checkpoint_every: save the state every so many iterations.
        rollout_batch_size: simulations of a device at a time, in random search, for less memory;
            the results are the same but for rounding. By default all, or what is fastest.
        track: ``wandb`` or ``trackio``, to follow the metrics there too, as docs/tracking.md says.
        watch: called after every iteration, for example with
            ``lambda report: print(report.iteration, report.metrics["evaluation_return"])``.
        settings: fields of the algorithm's settings to change, for example of
            :class:`~ailsrs_jax.trainers.ailsrs.AilsrsSettings`.

    Raises:
        UserError: something handed in is wrong, or most episodes of an iteration diverged.
    """
    assignments = {name: str(value) for name, value in settings.items()}
    plan = make_plan(
        env,
        demonstrations,
        num_trajectories,
        seeds,
        preset,
        physics,
        assignments,
        rollout_batch_size,
        subsample,
        algorithm,
    )
    return execute(
        plan,
        Path(output) if output else None,
        resume=resume,
        checkpoint_every=checkpoint_every,
        track=track,
        watch=watch,
    )


def make_plan(
    env: Env | str,
    demonstrations: str | Path | Demonstrations | None,
    num_trajectories: int | None,
    seeds: Sequence[int],
    preset: str,
    physics: str,
    assignments: dict[str, str],
    rollout_batch_size: int | None = None,
    subsample: int = 1,
    algorithm: str = "ailsrs",
) -> Plan:
    """Check everything that a run is given, before anything is written or computed.

    Raises:
        UserError: something is wrong.
    """
    set_up_jax()
    task, env_id, engine, reason = open_env(env, physics)
    if rollout_batch_size is not None and rollout_batch_size < 1:
        raise UserError(f"rollout_batch_size is {rollout_batch_size}: it must be at least 1")
    seeds = [int(seed) for seed in seeds]
    if not seeds or len(set(seeds)) < len(seeds):
        raise UserError(f"seeds are {seeds}: give one or more different ones")
    for seed in seeds:
        require_seed(seed)
    chosen = find_algorithm(algorithm)
    if rollout_batch_size is not None and not chosen.searches:
        raise UserError(f"rollout_batch_size is of random search: {algorithm} has no such episodes")
    settings = preset_settings(env_id, preset, algorithm)
    settings = override(settings, parse(settings, assignments))
    source = sha256 = None
    if chosen.imitates:
        demonstrations, source = find_demonstrations(
            demonstrations, num_trajectories, env_id, engine
        )
        require_fit(demonstrations, env_id, task)
        if subsample != 1:
            demonstrations = demonstrations.subsample(subsample)
        sha256 = content_hash(demonstrations)
    elif demonstrations is not None or num_trajectories is not None or subsample != 1:
        raise UserError(f"{algorithm} learns from the environment's reward, not demonstrations")
    else:
        demonstrations = None
    config = RunConfig(
        env_id=env_id,
        physics=engine,
        seeds=tuple(seeds),
        algorithm=algorithm,
        preset=preset,
        settings=settings,
        num_trajectories=demonstrations.num_trajectories if demonstrations else None,
        demonstrations=source,
        demonstrations_sha256=sha256,
        subsample=subsample if demonstrations else None,
    )
    devices = choose_devices(task, settings.num_directions) if chosen.searches else ONE_DEVICE
    if rollout_batch_size is None and chosen.searches:
        rollout_batch_size = choose_batch_size(task)
    return Plan(config, task, demonstrations, reason, devices, rollout_batch_size)


def execute(
    plan: Plan,
    output: Path | None = None,
    *,
    resume: bool = False,
    checkpoint_every: int = CHECKPOINT_EVERY,
    track: str | None = None,
    watch: Watch | None = None,
    stop: Callable[[], bool] = lambda: False,
) -> Result:
    """Run ``plan``, and write its directory ``output`` if there is one.

    Args:
        plan: what to do.
        output: the run directory.
        resume: go on from its newest checkpoint.
        checkpoint_every: so many iterations.
        track: where else the metrics go; see :mod:`~ailsrs_jax.runs.storage.trackers`.
        watch: called after every iteration.
        stop: asked after every iteration; if true, the state is saved and KeyboardInterrupt raised.

    Raises:
        UserError: the directory holds another run, is in use, or cannot be written; or most
            episodes of an iteration diverged.
    """
    config, settings = plan.config, plan.config.settings
    # First of all, because it refuses what it cannot train, and then nothing is to be written.
    trainer = plan.make_trainer()
    if checkpoint_every < 1:
        raise UserError(f"checkpoint_every is {checkpoint_every}: it must be at least 1")
    for name, given in (("resume", resume), ("track", track)):
        if given and output is None:
            raise UserError(f"{name} needs output, the directory of the run")
    require_tracker(track)
    with ExitStack() as stack:
        if output is not None:
            with together(config.fingerprint()):
                stack.enter_context(claimed(output, config, resume=resume))
        init = jax.jit(jax.vmap(lambda seed: trainer.init(jax.random.key(seed))))
        seeds = np.array(config.seeds, np.int32)
        num_done, progress = 0, {"state": init(seeds), "steps": np.zeros(len(seeds), np.int64)}
        directory = tracker = None
        if output is not None:
            with together():
                directory = stack.enter_context(RunDirectory(output, config, checkpoint_every))
                num_done, progress = directory.restore(progress)
            if is_first_process():
                tracker = stack.enter_context(tracked(track, [output]))

        for state, report in iterate(
            trainer.update,
            progress["state"],
            np.asarray(progress["steps"]),
            num_done,
            settings.num_iterations,
        ):
            stopping = anywhere(stop()) and not report.is_last
            try:
                report.require_most_finite()
            except UserError:
                if directory is not None:
                    with together():
                        directory.abandon(report, progress)
                raise
            progress = {"state": state, "steps": report.metrics["env_steps"]}
            if directory is not None:
                with together():
                    directory.record(report, progress, save=stopping or report.is_last)
            if tracker is not None:
                tracker.check()
            if watch is not None:
                watch(report)
            if stopping:
                raise KeyboardInterrupt

    state = progress["state"]
    return Result(
        config=config,
        policies=kept_policies(state, config),
        kept_iterations=dict(
            zip(config.seeds, np.asarray(state.kept.iteration).tolist(), strict=True)
        ),
        expert_returns=np.asarray(plan.demonstrations.returns) if plan.demonstrations else None,
    )
