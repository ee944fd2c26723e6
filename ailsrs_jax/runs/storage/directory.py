"""The directory of a run: who may write there, and what is written while the run goes."""

import contextlib
import errno
import fcntl
import logging
import os
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import Any

from ailsrs_jax.errors import InUseError, UserError
from ailsrs_jax.files import PARTIAL
from ailsrs_jax.runs.devices import is_first_process
from ailsrs_jax.runs.policies import kept_policies
from ailsrs_jax.runs.storage.checkpoint import Checkpoints
from ailsrs_jax.runs.storage.config import RunConfig, installed_versions, read_config
from ailsrs_jax.runs.storage.journal import Journal
from ailsrs_jax.runs.storage.metrics import IterationReport

LOCK = ".lock"

logger = logging.getLogger(__name__)


class RunDirectory:
    """Checkpoints, the journal and the kept policies of a run; a context manager.

    All processes of a run have one, and the first writes all but the checkpoints.
    """

    def __init__(self, path: Path, config: RunConfig, checkpoint_every: int) -> None:
        """Write to ``path``, which is :func:`claimed`."""
        self._path = path
        self._config = config
        self._journal: Journal | None = None
        self._checkpoints = Checkpoints(path / "checkpoints", checkpoint_every, config.as_json())

    def __enter__(self) -> "RunDirectory":
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self._checkpoints.__exit__(kind, error, traceback)
        if self._journal is not None:
            self._journal.close()

    def restore(self, progress: dict[str, Any]) -> tuple[int, dict[str, Any]]:
        """Iterations done, and ``progress`` as it was after them; 0 and itself without any.

        Raises:
            UserError: what is there cannot be read or is of another run, or ``metrics.csv`` lacks
                rows.
        """
        num_done, progress, about = self._checkpoints.restore(progress)
        if num_done > 0:  # it may be another run's, put here; versions were asked for before
            about |= {"versions": installed_versions()}
            self._config.require_same(about, self._path / "checkpoints")
        if is_first_process():
            self._journal = Journal(self._path, self._config, num_done, progress["steps"])
            if num_done > 0:
                save_policies(progress["state"], self._config, self._path)
        return num_done, progress

    def record(self, report: IterationReport, progress: dict[str, Any], *, save: bool) -> None:
        """Write one iteration's metrics and, if it is time or by ``save``, the progress.

        Raises:
            UserError: it cannot be written.
        """
        num_done = report.iteration + 1
        save = save or self._checkpoints.is_due(num_done)
        if self._journal is not None:
            self._journal.append(report, to_disk=save)
        if save:
            self._save(num_done, progress)

    def abandon(self, report: IterationReport, before: dict[str, Any]) -> None:
        """Write the metrics of an iteration that leads nowhere, and the progress before it.

        Raises:
            UserError: it cannot be written.
        """
        if self._journal is not None:
            self._journal.append(report, to_disk=True)
        self._save(report.iteration, before)

    def _save(self, num_done: int, progress: dict[str, Any]) -> None:
        self._checkpoints.save(num_done, progress)
        if is_first_process():
            save_policies(progress["state"], self._config, self._path)


def save_policies(state: Any, config: RunConfig, path: Path) -> None:
    """Write what the run keeps so far to its directory.

    Raises:
        UserError: it cannot be written.
    """
    for seed, policy in kept_policies(state, config).items():
        policy.save(path / f"seed_{seed}" / "policy.npz")


@contextlib.contextmanager
def claimed(path: Path, config: RunConfig, *, resume: bool) -> Iterator[None]:
    """Let nobody else write to the run directory ``path`` meanwhile; write its ``config.json``.

    A process that is killed loses its claim with its life.

    Raises:
        UserError: somebody else writes there, it holds another run, or it cannot be written.
    """
    config_path = path / "config.json"
    if resume:
        try:
            saved = read_config(config_path)
        except UserError as error:
            raise UserError(f"nothing to resume: {error}") from error
        config.require_same(saved, config_path)
    if not is_first_process():
        yield
        return
    # Before the lock, which would not be welcome among others' files; where there is one already,
    # somebody may be writing, and to know that is better than that something is there.
    if not resume and not os.path.lexists(path / LOCK):
        _require_empty(path)
    with _locked(path):
        if not resume:
            _require_empty(path)
            config.save(config_path)
        for partial in path.rglob(f".*{PARTIAL}"):  # of processes that were killed
            partial.unlink()
        yield


def _require_empty(path: Path) -> None:
    """Raise UserError if anything is there but hidden files, as a killed process may leave them."""
    try:
        occupied = path.exists() and (
            not path.is_dir() or not all(file.name.startswith(".") for file in path.iterdir())
        )
    except OSError as error:
        raise UserError(f"cannot write {path}: {error.strerror}") from error
    if occupied:
        raise UserError(f"{path} is not empty: add --resume to go on, or choose another --output")


@contextlib.contextmanager
def _locked(path: Path) -> Iterator[None]:
    with contextlib.ExitStack() as stack:
        try:
            path.mkdir(parents=True, exist_ok=True)
            # Nothing is truncated that a link may lead to, and no reader of a pipe is waited for.
            flags = os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC
            lock = os.open(path / LOCK, flags, 0o644)
            stack.callback(os.close, lock)
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise InUseError(f"another process is writing to {path}") from None
        except OSError as error:
            if error.errno not in (errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP):
                raise UserError(f"cannot write {path}: {error.strerror}") from error
            logger.warning("%s cannot be locked: let no other process write to it", path)
        yield
