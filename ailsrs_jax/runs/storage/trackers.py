"""Weights & Biases and Trackio: the metrics of a run, sent to their own clients."""

import contextlib
import contextvars
import csv
import importlib.util
import io
import json
import logging
import os
import re
import secrets
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

from ailsrs_jax.errors import UserError, one_line
from ailsrs_jax.runs.storage.metrics import IterationReport

PROJECT = "ailsrs"  # the default; WANDB_PROJECT or TRACKIO_PROJECT change it
ID_FILE = ".tracker"  # in the run directory; holds the identifier by which trackers know the run
INIT_SECONDS = 30  # how long W&B waits for its service when a run begins
FINISH_SECONDS = 60  # how long W&B waits for the last metrics to be uploaded

logger = logging.getLogger(__name__)


class About(NamedTuple):
    """What a tracker shows of one seed of a run."""

    id: str  # stays the same for a run directory and seed
    name: str  # for people
    group: str  # shared by runs that differ only in the seed
    config: dict[str, Any]  # config.json with this seed in place of all seeds
    directory: Path  # the run directory


# The client's own object for a run, with methods log and finish that may raise anything; and the
# first iteration that the tracker lacks.
Opened = tuple[Any, int]


class Tracker:
    """Sends the metrics of a run to a tracker, with each seed as a run of its own.

    A run does not depend on its tracker: the first error becomes one warning, and nothing more is
    sent. The client prints nothing to standard output, which may be JSON.
    """

    def __init__(self, name: str, directory: Path) -> None:
        """Begin or resume the run in ``directory``, and send the rows that the tracker lacks.

        The directory holds ``config.json`` and ``metrics.csv``.
        """
        self._name = name
        self._opened: dict[int, Opened] = {}  # by seed, in the order of the configuration
        with self._guarded():
            for about in _abouts(directory):
                self._opened[about.config["seed"]] = TRACKERS[name](about)
            with (directory / "metrics.csv").open(newline="") as file:
                for row in csv.DictReader(file):
                    self._log(int(row.pop("seed")), int(row.pop("iteration")), row)

    def append(self, report: IterationReport) -> None:
        """Send the metrics of an iteration."""
        with self._guarded():
            for index, seed in enumerate(self._opened):
                row = {name: str(values[index]) for name, values in report.metrics.items()}
                self._log(seed, report.iteration, row)

    def close(self) -> None:
        """Wait until the tracker has all metrics; the clients limit how long."""
        with self._guarded():
            for run, _ in self._opened.values():
                run.finish()
            self._opened = {}

    def _log(self, seed: int, iteration: int, row: dict[str, str]) -> None:
        """Send a row of ``metrics.csv`` unless the tracker has it already."""
        run, next_step = self._opened[seed]
        if iteration >= next_step:
            run.log({name: float(value) for name, value in row.items()}, step=iteration)

    @contextlib.contextmanager
    def _guarded(self) -> Iterator[None]:
        """Hide what the client prints, and stop tracking with a warning at its first error."""
        try:
            with contextlib.redirect_stdout(io.StringIO()):
                yield
        except Exception as error:
            self._opened = {}
            logger.warning("no longer tracked by %s: %s", self._name, one_line(error))


def _abouts(directory: Path) -> list[About]:
    """Describe each seed of the run in ``directory``."""
    id_path = directory / ID_FILE
    if id_path.is_symlink() or (id_path.exists() and not id_path.is_file()):
        raise UserError(f"{id_path} is not a file of this program")
    run_id = id_path.read_text().strip() if id_path.exists() else ""
    if not re.fullmatch("[0-9a-f]{12}", run_id):
        run_id = secrets.token_hex(6)
        id_path.write_text(f"{run_id}\n")
    config: dict[str, Any] = json.loads((directory / "config.json").read_text())
    seeds = config.pop("seeds")
    return [
        About(
            id=f"{run_id}-{seed}",
            name=directory.name if len(seeds) == 1 else f"{directory.name}/seed_{seed}",
            group=re.sub(r"-seed\d+$", "", directory.name),  # a sweep's cells end in their seed
            config=config | {"seed": seed},
            directory=directory,
        )
        for seed in seeds
    ]


def open_wandb(about: About) -> Opened:
    """Begin a run of Weights & Biases; its own environment variables say where, or offline."""
    import wandb

    settings = wandb.Settings(
        console="off",
        disable_git=True,
        silent=True,
        symlink=False,  # `ailsrs merge` copies only files
        init_timeout=INIT_SECONDS,
        finish_timeout=FINISH_SECONDS,
        finish_timeout_raises=True,
    )
    wandb.setup(settings)  # silent here too, or it asks for a login on the terminal
    run = wandb.init(
        id=about.id,
        name=about.name,
        group=os.environ.get("WANDB_RUN_GROUP", about.group),
        project=os.environ.get("WANDB_PROJECT", PROJECT),
        config=about.config,
        dir=about.directory,
        resume="allow",
        reinit="create_new",  # a run for each seed is open at the same time
        settings=settings,
    )
    run.define_metric("*", step_metric="env_steps")
    return run, run.step  # offline, step is 0: every offline run holds all rows


def open_trackio(about: About) -> Opened:
    """Begin a run of Trackio, on this machine or where its own environment variables say."""
    import trackio

    # In the same context, Trackio would end the run of the seed before.
    run = contextvars.Context().run(
        trackio.init,
        name=f"{about.name} {about.id[:6]}",  # Trackio finds a run to resume by its name
        group=about.group,
        project=os.environ.get("TRACKIO_PROJECT", PROJECT),
        config=about.config,
        resume="allow",
        embed=False,
        auto_log_gpu=False,
        auto_log_cpu=False,
    )
    return run, run._next_step


TRACKERS: dict[str, Callable[[About], Opened]] = {"wandb": open_wandb, "trackio": open_trackio}


def require_tracker(name: str | None) -> None:
    """Raise UserError if the tracker ``name`` is unknown or not installed."""
    if name is None:
        return
    if name not in TRACKERS:
        raise UserError(f"unknown tracker '{name}': use {' or '.join(TRACKERS)}")
    package = importlib.util.find_spec(name)
    if package is None or package.origin is None:  # a plain directory of that name has no origin
        raise UserError(f"tracking with {name} needs pip install 'ailsrs_jax[{name}]'")
