"""The training loop: of one run with its seeds, or of several runs stacked into one program.

Every seed of every run is a lane, that is an index of the leading axis of all arrays. A single run
has a lane for each of its seeds. Stacked runs have one seed each, and share their checkpoints while
they are trained.
"""

import dataclasses
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np

from ailsrs_jax.errors import UserError
from ailsrs_jax.host_calls import Interrupted, interruptible
from ailsrs_jax.runs.devices import compiler_options
from ailsrs_jax.runs.iterations import finished, iterate
from ailsrs_jax.runs.plan import Plan
from ailsrs_jax.runs.stacking import stack_trainers
from ailsrs_jax.runs.storage.checkpoint import Checkpoints
from ailsrs_jax.runs.storage.config import installed_versions
from ailsrs_jax.runs.storage.directory import claimed
from ailsrs_jax.runs.storage.journal import RESULT_FILE, Journal, Result
from ailsrs_jax.runs.storage.metrics import IterationReport, earlier_divergence
from ailsrs_jax.runs.storage.policies import MILESTONES, by_seed
from ailsrs_jax.runs.storage.processes import anywhere, is_first_process, together
from ailsrs_jax.runs.storage.trackers import require_tracker

Watch = Callable[[IterationReport], None]
Progress = dict[str, Any]  # the training state, and the live steps of each lane so far


class _Run:
    """One of the runs that are trained together."""

    def __init__(self, plan: Plan, output: Path | None, lane: int | None) -> None:
        """Use one ``lane`` of a stack, or all lanes if ``lane`` is None."""
        self.problem: UserError | None = None  # most episodes of an iteration diverged
        self._plan, self._output, self._lane = plan, output, lane
        self._journal: Journal | None = None

    def begin(self, progress: Progress, track: str | None, stack: ExitStack) -> None:
        """Open the journal, which only the first process has, until ``stack`` closes it."""
        if self._output is None or not is_first_process():
            return
        num_done, steps = self._num_done(progress), self._part(progress["steps"])
        journal = Journal(self._output, self._plan.config, num_done, steps, track)
        self._journal = stack.enter_context(closing(journal))
        if num_done > 0:
            self.problem = earlier_divergence(self._output / "metrics.csv")
            self.save(progress)

    def is_finished(self, progress: Progress) -> bool:
        """Tell whether no iteration of this run is left."""
        over = np.broadcast_to(finished(progress["state"]), len(progress["steps"]))
        num_iterations: int = self._plan.config.settings.num_iterations
        return self._num_done(progress) == num_iterations or bool(self._of_lane(over).all())

    def append(self, report: IterationReport, progress: Progress, *, to_disk: bool) -> None:
        """Append an iteration to the journal, which led to ``progress``."""
        if self._journal is not None:
            self._journal.append(self.part_of(report), to_disk=to_disk)
            iteration = self._num_done(progress) - 1
            if iteration in MILESTONES:
                offered = self._part(progress["state"].kept.offered)
                self._journal.save_evaluated(iteration, offered)

    def save(self, progress: Progress) -> None:
        """Write policies and ``result.json``."""
        if self._journal is not None:
            self._journal.save(
                self._result(progress),
                self._part(progress["steps"]),
                command=self._plan.spec.command,
                finished=self.problem is None and self.is_finished(progress),
            )

    def end(self, progress: Progress) -> Result:
        """Return the result, and leave a checkpoint of its own for a run of a stack."""
        if self._lane is not None and self._output is not None:
            about = self._plan.config.as_json()
            with Checkpoints(self._output / "checkpoints", about=about) as checkpoints:
                part = jax.tree.map(self._of_lane, progress)
                checkpoints.save(self._num_done(progress), part)
        return self._result(progress)

    def _result(self, progress: Progress) -> Result:
        config = self._plan.config
        kept = self._part(progress["state"].kept)
        iterations, scores = (np.asarray(x).tolist() for x in (kept.iteration, kept.score))
        return Result(
            config=config,
            policies=by_seed(kept.policy, config),
            kept_iterations=dict(zip(config.seeds, iterations, strict=True)),
            scores=dict(zip(config.seeds, scores, strict=True)),
            expert_returns=self._plan.data.expert_returns,
            demonstrated_length=self._plan.data.time_limit,
        )

    def _num_done(self, progress: Progress) -> int:
        return int(np.max(self._part(progress["state"].iteration)))

    def _part(self, lanes: Any) -> Any:
        """Return what belongs to this run; slicing on the device would take much longer."""
        return lanes if self._lane is None else jax.tree.map(self._of_lane, jax.device_get(lanes))

    def _of_lane(self, x: Any) -> Any:
        return x if self._lane is None else x[self._lane : self._lane + 1]

    def part_of(self, report: IterationReport) -> IterationReport:
        """Return the metrics of this run, with an equal share of the time of all runs."""
        if self._lane is None:
            return report
        count = len(report.metrics["env_steps"])
        return dataclasses.replace(
            report,
            metrics={name: self._of_lane(values) for name, values in report.metrics.items()},
            seconds=report.seconds / count,
            compile_seconds=report.compile_seconds and report.compile_seconds / count,
        )


def execute(
    plans: Sequence[Plan],
    outputs: Sequence[Path | None],
    *,
    checkpoints: Path | None = None,
    resume: bool | Literal["where begun"] = False,
    checkpoint_every: int | None = None,
    track: str | None = None,
    watch: Watch | None = None,
    stop: Callable[[], bool] = lambda: False,
) -> list[Result | UserError]:
    """Train one run, or several runs of one seed and equal ``stack_key`` as one program.

    An interrupted run or stack resumes bit for bit. Stacked runs draw the same random numbers as
    each alone, bit for bit, and their results agree up to rounding, because XLA multiplies stacked
    matrices in another order.

    Args:
        plans: the runs.
        outputs: the directory of each; None to write nothing.
        checkpoints: the directory of the shared checkpoints of several runs. A stack resumes from
            it only with the same runs in the same order.
        resume: go on from the newest checkpoint; ``"where begun"``: wherever there is a run.
        checkpoint_every: see :func:`~ailsrs_jax.runs.run.train`.
        track: see there.
        watch: called after every iteration, with the metrics of all lanes.
        stop: called after every iteration, and during one that MuJoCo's C engine simulates; if it
            returns true, the state is saved and KeyboardInterrupt is raised.

    Returns:
        The result of each run. If most episodes of an iteration diverged in one of several runs,
        the error that says so takes its place, and the other runs go on.

    Raises:
        UserError: a directory holds another run, is in use, or cannot be written; or most episodes
            of an iteration diverged in the only run.
    """
    # A trainer refuses wrong settings, so it is made before anything is written.
    make_trainer, arguments = stack_trainers([plan.make_trainer() for plan in plans])
    is_stack = len(plans) > 1
    _require_options(outputs, resume, checkpoint_every, track)
    runs = [
        _Run(plan, output, lane=index if is_stack else None)
        for index, (plan, output) in enumerate(zip(plans, outputs, strict=True))
    ]
    if checkpoints is None and outputs[0] is not None:
        checkpoints = outputs[0] / "checkpoints"
        if resume is True and (outputs[0] / RESULT_FILE).exists() and not checkpoints.exists():
            raise UserError(
                f"nothing to resume: {outputs[0]} has a result but no {checkpoints.name}; in a "
                "sweep, continue the sweep; else train again in another directory"
            )

    def init(seed: jax.Array, part: Any) -> Any:
        return make_trainer(part).init(jax.random.key(seed))

    def update(state: Any, part: Any) -> tuple[Any, dict[str, jax.Array]]:
        new_state, metrics = make_trainer(part).update(state)
        if hasattr(state, "finished"):  # a finished lane waits for the others
            new_state = jax.tree.map(
                lambda old, new: jnp.where(state.finished, old, new), state, new_state
            )
            metrics["env_steps"] = jnp.where(state.finished, 0, metrics["env_steps"])
        return new_state, metrics

    with ExitStack() as stack:
        if directories := [output for output in outputs if output is not None]:
            with together(plans[0].config.fingerprint()):
                for plan, directory in zip(plans, directories, strict=True):
                    stack.enter_context(claimed(directory, plan.config, resume=resume))
        seeds = np.array([seed for plan in plans for seed in plan.config.seeds], np.int32)
        place = plans[0].simulator.everywhere
        state = jax.jit(jax.vmap(init), out_shardings=place)(seeds, arguments)
        progress: Progress = {"state": state, "steps": np.zeros(len(seeds), np.int64)}
        num_done, saver = 0, None
        if checkpoints is not None:
            about = {} if is_stack else plans[0].config.as_json()
            with together():
                saver = stack.enter_context(Checkpoints(checkpoints, checkpoint_every, about))
                num_done, progress, found = saver.restore(progress)
                if num_done > 0 and not is_stack:  # another run's checkpoints may have been copied
                    found |= {"versions": installed_versions()}  # config.json has been compared
                    plans[0].config.require_same(found, checkpoints)
                for run in runs:
                    run.begin(progress, track, stack)

        def save_all() -> None:
            if saver is not None:
                saver.save(num_done, progress)
                for run in runs:
                    run.save(progress)

        is_alone = jax.process_count() == 1  # other processes would wait for this one
        if is_alone:
            stack.enter_context(interruptible(stop))

        def iterations() -> Iterator[tuple[Any, IterationReport]]:
            """Iterate; if an iteration is interrupted or fails, save the state before it."""
            try:
                yield from iterate(
                    update,
                    progress["state"],
                    np.asarray(progress["steps"]),
                    num_done,
                    plans[0].config.settings.num_iterations,
                    arguments,
                    place=place,
                    compiler_options=compiler_options(plans[0].simulator.env),
                )
            except Interrupted:
                save_all()
                raise KeyboardInterrupt from None
            except Exception:
                if is_alone:
                    save_all()
                raise

        for state, report in iterations():
            stopping = anywhere(stop()) and not report.is_last
            going = [run for run in runs if not run.is_finished(progress)]
            for run in going:
                run.problem = run.problem or run.part_of(report).divergence
            failed = all(run.problem is not None for run in runs)
            num_done = report.iteration
            if not failed:
                num_done += 1
                progress = {"state": state, "steps": report.metrics["env_steps"]}
            over = all(run.problem or run.is_finished(progress) for run in runs)
            if saver is not None:
                save = over or stopping or saver.is_due(num_done)
                with together():
                    began = time.monotonic()
                    for run in going:
                        run.append(report, progress, to_disk=save)
                    if save:
                        save_all()
                        saver.rest(began)
            if failed:
                break
            if watch is not None:
                watch(report)
            if stopping:
                raise KeyboardInterrupt
            if over:
                break

        if not is_stack and runs[0].problem is not None:
            raise runs[0].problem
        return [run.problem or run.end(progress) for run in runs]


def _require_options(
    outputs: Sequence[Path | None], resume: object, checkpoint_every: int | None, track: str | None
) -> None:
    if checkpoint_every is not None and checkpoint_every < 1:
        raise UserError(f"checkpoint_every is {checkpoint_every}: it must be at least 1")
    for name, given in (("resume", resume), ("track", track)):
        if given and None in outputs:
            raise UserError(f"{name} needs output, the directory of the run")
    require_tracker(track)
