"""The lock on the directory of a run."""

import contextlib
import errno
import fcntl
import logging
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Literal

from ailsrs_jax.errors import InUseError, UserError, os_errors
from ailsrs_jax.files import PARTIAL
from ailsrs_jax.runs.storage.config import RunConfig, read_config
from ailsrs_jax.runs.storage.processes import is_first_process

LOCK = ".lock"

logger = logging.getLogger(__name__)


@contextlib.contextmanager
def claimed(
    path: Path, config: RunConfig, *, resume: bool | Literal["where begun"]
) -> Iterator[None]:
    """Lock the run directory ``path``, and write its ``config.json`` if the run is new.

    The operating system releases the lock when the process ends, however it ends.

    Raises:
        UserError: another process writes there, it holds another run, or it cannot be written.
    """
    config_path = path / "config.json"
    if resume == "where begun":
        resume = config_path.exists()
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
    with locked(path):
        if not resume:
            _require_empty(path)
            config.save(config_path)
        with os_errors(f"cannot write {path}"):
            for partial in path.rglob(f".*{PARTIAL}"):  # left by killed processes
                if not partial.is_dir():
                    partial.unlink(missing_ok=True)
        yield


def _require_empty(path: Path) -> None:
    """Raise UserError unless only hidden files are there, which a killed process may leave."""
    with os_errors(f"cannot write {path}"):
        occupied = path.exists() and (
            not path.is_dir() or not all(file.name.startswith(".") for file in path.iterdir())
        )
    if occupied:
        raise UserError(f"{path} is not empty: add --resume to go on, or choose another --output")


@contextlib.contextmanager
def locked(path: Path) -> Iterator[None]:
    """Make the directory ``path`` if it is missing, and lock it.

    Raises:
        InUseError: another process has locked it.
        UserError: it cannot be written.
    """
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
