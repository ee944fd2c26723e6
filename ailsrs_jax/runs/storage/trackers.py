"""Weights & Biases and Trackio, behind one small interface."""

import contextvars
import importlib.util
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple, Protocol

from ailsrs_jax.errors import UserError

PROJECT = "ailsrs"  # unless WANDB_PROJECT or TRACKIO_PROJECT says otherwise
PATIENCE = 30  # seconds for a service to answer


class About(NamedTuple):
    """What a tracker is told of one seed of a run before it begins."""

    id: str  # the same for the same run directory and seed
    name: str  # for people
    group: str  # of what differs in nothing but the seed
    config: dict[str, Any]  # as in config.json, but of this seed
    directory: Path  # of the run


class TrackedRun(Protocol):
    """What a tracker gives for it, which may raise whatever it likes."""

    def log(self, data: dict[str, float], *, step: int) -> None:
        """Add the metrics of an iteration."""

    def finish(self) -> None:
        """Return when all of them have arrived."""


class Opened(NamedTuple):
    """A run that a tracker has begun, or goes on with."""

    run: TrackedRun
    next_step: int  # the first that it does not have


def open_wandb(about: About) -> Opened:
    """Weights & Biases; its own environment variables say where to, and whether offline."""
    import wandb

    run = wandb.init(
        id=about.id,
        name=about.name,
        group=os.environ.get("WANDB_RUN_GROUP", about.group),
        project=os.environ.get("WANDB_PROJECT", PROJECT),
        config=about.config,
        dir=about.directory,
        resume="allow",
        reinit="create_new",  # there is one for each seed
        settings=wandb.Settings(
            console="off",
            disable_git=True,
            silent=True,
            symlink=False,  # `ailsrs merge` copies files only
            init_timeout=PATIENCE,
        ),
    )
    run.define_metric("*", step_metric="env_steps")
    return Opened(run, run.step)  # offline from 0 again: each offline run is complete


def open_trackio(about: About) -> Opened:
    """Trackio, on this machine or where its own environment variables say."""
    import trackio

    # Trackio ends the run before as it begins another, if both are of the same context.
    run = contextvars.Context().run(
        trackio.init,
        name=f"{about.name} {about.id[:6]}",  # by which it is found again
        group=about.group,
        project=os.environ.get("TRACKIO_PROJECT", PROJECT),
        config=about.config,
        resume="allow",
        embed=False,
        auto_log_gpu=False,
        auto_log_cpu=False,
    )
    return Opened(run, run._next_step)


TRACKERS: dict[str, Callable[[About], Opened]] = {"wandb": open_wandb, "trackio": open_trackio}


def require_tracker(name: str | None) -> None:
    """Raise UserError unless there is such a tracker, and it is installed."""
    if name is None:
        return
    if name not in TRACKERS:
        raise UserError(f"unknown tracker '{name}': use {' or '.join(TRACKERS)}")
    package = importlib.util.find_spec(name)
    if package is None or package.origin is None:  # a mere directory of that name
        raise UserError(f"tracking with {name} needs pip install 'ailsrs_jax[{name}]'")
