"""Runs of the same shapes as one program: what differs among them is an axis of its arrays."""

import dataclasses
from collections.abc import Callable, Hashable, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ailsrs_jax.errors import UserError
from ailsrs_jax.runs.iterations import iterate
from ailsrs_jax.runs.policies import kept_policies
from ailsrs_jax.runs.run import CHECKPOINT_EVERY, Plan, Result, Watch
from ailsrs_jax.runs.storage.checkpoint import Checkpoints
from ailsrs_jax.runs.storage.directory import claimed, save_policies
from ailsrs_jax.runs.storage.journal import Journal
from ailsrs_jax.runs.storage.metrics import IterationReport, read_metrics, require_most_finite
from ailsrs_jax.runs.storage.trackers import Tracker
from ailsrs_jax.trainers.parts.reference import Reference
from ailsrs_jax.trainers.parts.trainer import Trainer


def stack_key(plan: Plan) -> Hashable:
    """What has to be equal for two runs to be stacked.

    All of their settings but the real-valued ones, of which only those that are 0 stay apart:
    there a term can be left out. Episodes of demonstrations may differ in number, not in length.
    """
    config, demonstrations = plan.config, plan.demonstrations
    settings = tuple(
        (name, value == 0 if isinstance(value, float) else value)
        for name, value in vars(config.settings).items()
    )
    recorded = None
    if demonstrations is not None:
        has_actions = demonstrations.actions is not None
        recorded = (demonstrations.observations.shape[1:], demonstrations.stride, has_actions)
    return config.algorithm, config.env_id, config.physics, settings, recorded


def execute_stack(
    plans: Sequence[Plan],
    outputs: Sequence[Path],
    checkpoint_directory: Path,
    watches: Sequence[Watch],
    watch: Watch | None = None,
    track: str | None = None,
    stop: Callable[[], bool] = lambda: False,
) -> list[Result | UserError]:
    """Run ``plans`` of one seed each, and the same :func:`stack_key`, together.

    Each has its own run directory, as :func:`~ailsrs_jax.runs.run.execute` leaves it. While they
    are trained, one checkpoint holds the state of all, so that they are always equally far, and an
    interrupted stack of the same runs in the same order goes on bit for bit.

    Random numbers are those of the runs alone, bit for bit; the results agree to rounding, because
    XLA sums the products of stacked matrices in another order.

    Args:
        plans: the runs.
        outputs: their directories.
        checkpoint_directory: of all together.
        watches: told of each run's iterations.
        watch: told of those of all together.
        track: where else the metrics go; see :mod:`~ailsrs_jax.runs.storage.trackers`.
        stop: asked after every iteration; if true, the state is saved and KeyboardInterrupt raised.

    Returns:
        Of each run its result; or, if most episodes of an iteration diverged, the error that says
        so, which would have stopped it had it been alone.

    Raises:
        UserError: a directory holds another run, is in use, or cannot be written.
    """
    num_iterations = plans[0].config.settings.num_iterations
    make_trainer, arguments = stack_trainers([plan.make_trainer() for plan in plans])

    def init(seed: jax.Array, arguments: Any) -> Any:
        return make_trainer(arguments).init(jax.random.key(seed))

    def update(state: Any, arguments: Any) -> tuple[Any, dict[str, jax.Array]]:
        new_state, metrics = make_trainer(arguments).update(state)
        if hasattr(state, "finished"):  # it waits for the others
            new_state = jax.tree.map(
                lambda old, new: jnp.where(state.finished, old, new), state, new_state
            )
            metrics["env_steps"] = jnp.where(state.finished, 0, metrics["env_steps"])
        return new_state, metrics

    with ExitStack() as stack:
        for plan, output in zip(plans, outputs, strict=True):
            resume = (output / "config.json").exists()
            stack.enter_context(claimed(output, plan.config, resume=resume))
        seeds = np.array([plan.config.seeds[0] for plan in plans], np.int32)
        state = jax.jit(jax.vmap(init))(seeds, arguments)
        progress = {"state": state, "steps": np.zeros(len(plans), np.int64)}
        checkpoints = stack.enter_context(Checkpoints(checkpoint_directory, CHECKPOINT_EVERY))
        num_done, progress, _ = checkpoints.restore(progress)
        journals = [  # of a run that was finished before the others no more rows are expected
            Journal(output, plan.config, int(mine), progress["steps"][index : index + 1])
            for index, (plan, output, mine) in enumerate(
                zip(plans, outputs, progress["state"].iteration, strict=True)
            )
        ]
        trackers = [] if track is None else [Tracker(track, output) for output in outputs]
        closes = [journal.close for journal in journals] + [each.close for each in trackers]
        for close in closes:
            stack.callback(close)
        waiting = _finished(progress["state"], len(plans))
        for state, report in iterate(
            update,
            progress["state"],
            np.asarray(progress["steps"]),
            num_done,
            num_iterations,
            arguments,
        ):
            progress = {"state": state, "steps": report.metrics["env_steps"]}
            stopping = stop() and not report.is_last
            save = stopping or report.is_last or checkpoints.is_due(report.iteration + 1)
            for index in np.flatnonzero(~waiting).tolist():
                mine = _part_of_report(report, index)
                journals[index].append(mine, to_disk=save)
                if trackers:
                    trackers[index].append(mine)
                watches[index](mine)
            if save:
                checkpoints.save(report.iteration + 1, progress)
                for index, (plan, output) in enumerate(zip(plans, outputs, strict=True)):
                    save_policies(_part(progress, index)["state"], plan.config, output)
            if watch is not None:
                watch(report)
            if stopping:
                raise KeyboardInterrupt
            waiting = _finished(state, len(plans))

        return [
            _result(plan, output, _part(progress, index))
            for index, (plan, output) in enumerate(zip(plans, outputs, strict=True))
        ]


def stack_trainers(trainers: Sequence[Trainer]) -> tuple[Callable[[Any], Trainer], Any]:
    """How to make a trainer of its part of the returned arrays, which are stacks of all parts.

    What is the same in all of them is not in the arrays, but in what is made of them.
    """
    members: list[Any] = list(trainers)  # some have a reference
    template = members[0]
    settings = [vars(trainer.settings) for trainer in members]
    arguments: dict[str, Any] = {
        "settings": {
            name: np.array([each[name] for each in settings], np.float32)
            for name in settings[0]
            if len({each[name] for each in settings}) > 1
        }
    }
    if hasattr(template, "reference"):
        experts = [trainer.reference for trainer in members]
        if not all(_same(expert, experts[0]) for expert in experts):
            most = max(len(expert.lengths) for expert in experts)
            padded = [_pad(expert, most) for expert in experts]
            arguments["reference"] = jax.tree.map(lambda *xs: jnp.stack(xs), *padded)

    def make(part: Any) -> Trainer:
        changes = {"settings": dataclasses.replace(template.settings, **part["settings"])}
        if "reference" in part:
            changes["reference"] = part["reference"]
        made: Trainer = dataclasses.replace(template, **changes)
        return made

    return make, arguments


def _same(one: Reference, other: Reference) -> bool:
    leaves = jax.tree.leaves(one), jax.tree.leaves(other)
    return all(np.array_equal(x, y) for x, y in zip(*leaves, strict=True))


def _pad(expert: Reference, num_episodes: int) -> Reference:
    """With episodes of no steps behind its own."""

    def pad(array: jax.Array) -> jax.Array:
        missing = num_episodes - len(expert.lengths)
        return jnp.pad(array, [(0, missing)] + [(0, 0)] * (array.ndim - 1))

    padded: Reference = expert.replace(
        observations=pad(expert.observations),
        actions=pad(expert.actions),
        lengths=pad(expert.lengths),
    )
    return padded


def _part(progress: dict[str, Any], index: int) -> dict[str, Any]:
    """What one run's own checkpoint holds."""
    part: dict[str, Any] = jax.tree.map(lambda x: x[index : index + 1], progress)
    return part


def _finished(state: Any, num_runs: int) -> np.ndarray:
    return np.broadcast_to(np.asarray(getattr(state, "finished", False)), num_runs)


def _part_of_report(report: IterationReport, index: int) -> IterationReport:
    """What one run is told: its metrics, with the time and the speed of all together."""
    metrics = {name: values[index : index + 1] for name, values in report.metrics.items()}
    return dataclasses.replace(report, metrics=metrics)


def _result(plan: Plan, output: Path, progress: dict[str, Any]) -> Result | UserError:
    """Of one run; its checkpoint and policy are written as if it had been alone."""
    metrics = read_metrics(output / "metrics.csv")  # which know what happened before a resume, too
    columns = (metrics[name].astype(int) for name in ("iteration", "episodes", "diverged"))
    for row in zip(*columns, strict=True):
        try:
            require_most_finite(*row)
        except UserError as error:
            return error
    config, state = plan.config, progress["state"]
    (seed,) = config.seeds
    directory = output / "checkpoints"
    with Checkpoints(directory, CHECKPOINT_EVERY, config.as_json()) as checkpoints:
        checkpoints.save(int(state.iteration[0]), progress)
    save_policies(state, config, output)
    return Result(
        config=config,
        policies=kept_policies(state, config),
        kept_iterations={seed: int(state.kept.iteration[0])},
        expert_returns=np.asarray(plan.demonstrations.returns) if plan.demonstrations else None,
    )
