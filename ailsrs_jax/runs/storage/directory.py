"""The directory of a run: the lock on it, and the files that are written during the run."""

import contextlib
import errno
import fcntl
import json
import logging
import math
import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ailsrs_jax.errors import InUseError, UserError
from ailsrs_jax.files import PARTIAL, write_atomically
from ailsrs_jax.runs.storage.config import RunConfig, read_config
from ailsrs_jax.runs.storage.journal import Journal
from ailsrs_jax.runs.storage.metrics import IterationReport
from ailsrs_jax.runs.storage.policies import save_policies
from ailsrs_jax.runs.storage.processes import is_first_process

LOCK = ".lock"
RESULT_FILE = "result.json"

logger = logging.getLogger(__name__)


class RunDirectory:
    """Writes the journal, the policies and ``result.json`` of a run, but no checkpoints."""

    def __init__(
        self,
        path: Path,
        config: RunConfig,
        *,
        command: str | None,
        expert_returns: np.ndarray | None,
    ) -> None:
        """Write to ``path``, which is :func:`claimed`.

        Args:
            path: the run directory.
            config: of the run.
            command: the command line that makes the run again, if there is one.
            expert_returns: of the demonstrations, if the run has any.
        """
        self._path = path
        self._config = config
        self._about = {"command": command, "expert_return": _mean_and_std(expert_returns)}
        self._journal: Journal | None = None

    def begin(self, num_done: int, progress: Mapping[str, Any], track: str | None) -> None:
        """Open the journal after ``num_done`` iterations, and drop what was written after them.

        Raises:
            UserError: ``metrics.csv`` or ``seconds.csv`` lacks rows, or cannot be written.
        """
        self._journal = Journal(self._path, self._config, num_done, progress["steps"], track)

    def append(self, report: IterationReport, *, to_disk: bool) -> None:
        """Append an iteration to the journal.

        Raises:
            UserError: it cannot be written.
        """
        assert self._journal is not None
        self._journal.append(report, to_disk=to_disk)

    def save(self, progress: Mapping[str, Any], *, finished: bool) -> None:
        """Write the kept policies and ``result.json``.

        Raises:
            UserError: they cannot be written.
        """
        assert self._journal is not None
        save_policies(progress["state"], self._config, self._path)
        kept = progress["state"].kept
        seeds = {}
        for seed, iteration, score in zip(
            self._config.seeds, np.asarray(kept.iteration), np.asarray(kept.score), strict=True
        ):
            if math.isfinite(score):  # else no policy has had a score yet
                seeds[str(seed)] = {"kept_iteration": int(iteration), "score": float(score)}
        steps = {str(seed): int(n) for seed, n in zip(self._config.seeds, progress["steps"])}
        fields = {"finished": finished, "env_steps": steps, "seconds": self._journal.seconds}
        text = json.dumps(self._about | fields | {"seeds": seeds}, indent=2)
        write_atomically(self._path / RESULT_FILE, lambda file: file.write(f"{text}\n".encode()))

    def close(self) -> None:
        """Close the journal."""
        if self._journal is not None:
            self._journal.close()


def _mean_and_std(returns: np.ndarray | None) -> dict[str, float] | None:
    if returns is None:
        return None
    return {"mean": float(np.mean(returns)), "std": float(np.std(returns))}


@contextlib.contextmanager
def claimed(path: Path, config: RunConfig, *, resume: bool) -> Iterator[None]:
    """Lock the run directory ``path``, and write its ``config.json`` if the run is new.

    The operating system releases the lock when the process ends, however it ends.

    Raises:
        UserError: another process writes there, it holds another run, or it cannot be written.
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
    # Checked before the lock file is made, which does not belong among other people's files. If
    # there is a lock file, "another process is writing" is the better message, so it comes first.
    if not resume and not os.path.lexists(path / LOCK):
        _require_empty(path)
    with _locked(path):
        if not resume:
            _require_empty(path)
            config.save(config_path)
        for partial in path.rglob(f".*{PARTIAL}"):  # left by killed processes
            partial.unlink()
        yield


def _require_empty(path: Path) -> None:
    """Raise UserError unless only hidden files are there, which a killed process may leave."""
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
            # A link is not followed, because its target may be precious, and opening a pipe does
            # not wait for a reader.
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
