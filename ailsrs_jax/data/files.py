"""Reading archives that may be anything; writing files so that nobody sees half of one."""

import json
import os
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import IO, Any

import numpy as np

from ailsrs_jax.errors import UserError, one_line

MAX_JSON = 2**20  # bytes; ours have a few thousand
PARTIAL = ".partial"  # how the hidden files end that a process was killed while writing


def write_atomically(path: str | Path, write: Callable[[IO[bytes]], object]) -> None:
    """Call ``write`` with a temporary file beside ``path``, then rename it to ``path``.

    Raises:
        UserError: the place cannot be written to.
    """
    path = Path(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(
            dir=path.parent, prefix=f".{path.name}.", suffix=PARTIAL, delete=False
        ) as file:
            temporary = Path(file.name)
            try:
                write(file)
                file.flush()
                os.fsync(file.fileno())
                temporary.chmod(0o644)  # temporary files are private, results are not
                temporary.replace(path)
            except BaseException:
                temporary.unlink()
                raise
    except OSError as error:
        raise UserError(f"cannot write {path}: {error.strerror or error}") from error


def require_writable(path: Path) -> None:
    """Raise UserError unless a file can be written at ``path``: for asking before a long run."""
    folder = path.parent
    try:
        while not folder.exists():
            folder = folder.parent
        writable = not path.is_dir() and folder.is_dir() and os.access(folder, os.W_OK)
    except OSError as error:
        raise UserError(f"cannot write {path}: {error.strerror}") from error
    if not writable:
        raise UserError(f"cannot write {path}")


def require_file(path: Path) -> None:
    """Raise UserError unless ``path`` is a file: a pipe or a device could be read for ever.

    The message says what it is instead.
    """
    try:
        is_there, is_file = path.exists(), path.is_file()
    except (OSError, ValueError) as error:
        raise UserError(f"cannot read {path}: {one_line(error)}") from error
    if not is_there:
        raise UserError(f"no such file: {path}")
    if not is_file:
        raise UserError(f"{path} is not a file")


def read_json_object(path: Path, what: str) -> dict[str, Any]:
    """Read a small JSON file that should hold ``what``, an object.

    Raises:
        UserError: it is missing, damaged, or something else.
    """
    require_file(path)
    try:
        with path.open("rb") as file:
            content = file.read(MAX_JSON + 1)
        if len(content) > MAX_JSON:
            raise ValueError("it is too long")
        value = json.loads(content)
        if not isinstance(value, dict):
            raise ValueError("it is no JSON object")
    except (OSError, ValueError, RecursionError) as error:
        raise UserError(f"{path} is not {what}: {one_line(error)}") from error
    return value


def read_npz(
    path: Path, fields: tuple[str, ...], what: str, optional: tuple[str, ...] = ()
) -> dict[str, np.ndarray]:
    """Read the arrays ``fields``, and those of ``optional`` that are there, of a ``.npz`` file.

    Messages say that it should be a file of ``what``.

    Raises:
        UserError: it is missing, damaged, pickled, or lacks a field.
    """
    try:
        with path.open("rb") as file:
            archive = np.load(file, allow_pickle=False)
            if not isinstance(archive, np.lib.npyio.NpzFile):
                raise UserError(f"{path} is not a .npz file of {what}")
            missing = [name for name in fields if name not in archive.files]
            if missing:
                raise UserError(f"{path} has no {', '.join(missing)}: not a file of {what}")
            present = [name for name in optional if name in archive.files]
            return {name: archive[name] for name in (*fields, *present)}
    except UserError:
        raise
    except FileNotFoundError:
        raise UserError(f"no such file: {path}") from None
    except Exception as error:  # damaged archives raise whatever their reader stumbles over
        reason = "it holds pickled objects" if "pickle" in str(error) else "it is damaged"
        raise UserError(f"{path} is not a .npz file of {what}: {reason}") from error
