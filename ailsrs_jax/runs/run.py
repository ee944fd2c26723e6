"""Training from Python."""

import dataclasses
from pathlib import Path
from typing import Any

from ailsrs_jax.data.demonstrations import Demonstrations
from ailsrs_jax.envs import Env
from ailsrs_jax.runs.loop import Watch, execute
from ailsrs_jax.runs.plan import plan
from ailsrs_jax.runs.spec import RunSpec
from ailsrs_jax.runs.storage.journal import Result

FIELDS = {field.name for field in dataclasses.fields(RunSpec)} - {"settings"}


def train(
    env: Env | str,
    demonstrations: str | Path | Demonstrations | None = None,
    *,
    output: str | Path | None = None,
    resume: bool = False,
    checkpoint_every: int | None = None,
    track: str | None = None,
    watch: Watch | None = None,
    **options: Any,
) -> Result:
    """Train a policy to imitate demonstrations, or on the environment's reward.

    >>> import ailsrs_jax as ail
    >>> short = {"num_iterations": 2, "num_directions": 8, "episode_length": 100}
    >>> run = ail.train("swimmer", num_trajectories=2, seeds=[0, 1], **short)
    >>> run.policies[1](8 * [0.0]).shape
    (2,)

    Args:
        env: see :class:`~ailsrs_jax.runs.spec.RunSpec`, as for ``demonstrations``.
        demonstrations: by default those of the expert that ships with the package.
        output: the run directory to write; by default nothing is written.
        resume: go on from the newest checkpoint in ``output``.
        checkpoint_every: save the state every so many iterations. With None, it is every ten, with
            a rest after each: a second, or nine times as long as saving has stopped the training.
        track: ``wandb`` or ``trackio``, which receives the metrics too; see docs/tracking.md.
        watch: called after every iteration, for example with
            ``lambda report: print(report.iteration, report.metrics["evaluation_return"])``.
        options: the other fields of :class:`~ailsrs_jax.runs.spec.RunSpec`, such as ``algorithm``,
            ``num_trajectories``, ``seeds`` and ``preset``, and settings of the algorithm, such as
            those of :class:`~ailsrs_jax.trainers.parts.ailsrs_settings.AilsrsSettings`.

    Raises:
        UserError: an argument is wrong, or most episodes of an iteration diverged.
    """
    fields = {name: value for name, value in options.items() if name in FIELDS}
    settings = {name: value for name, value in options.items() if name not in FIELDS}
    spec = RunSpec(env, demonstrations, settings=settings, **fields)
    (result,) = execute(
        [plan(spec)],
        [Path(output) if output else None],
        resume=resume,
        checkpoint_every=checkpoint_every,
        track=track,
        watch=watch,
    )
    assert isinstance(result, Result)  # a single run raises its error
    return result
