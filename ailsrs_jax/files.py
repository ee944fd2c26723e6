"""Reading archives that may be anything; writing files so that nobody sees half of one."""

import json
import os
import tempfile
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import IO, Any

import numpy as np

from ailsrs_jax.errors import UserError, one_line

MAX_JSON = 2**20  # bytes; ours have a few thousand
MAX_NAME = 200  # characters
SMALL = 2**28  # bytes that any machine has
MAX_COMPRESSION = 100
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


def read_small(path: Path, limit: int = MAX_JSON) -> bytes:
    """What a file holds, of at most ``limit`` bytes.

    Raises:
        UserError: it is no file, or cannot be read.
        ValueError: it is longer.
    """
    require_file(path)
    try:
        with path.open("rb") as file:
            content = file.read(limit + 1)
    except OSError as error:
        raise UserError(f"cannot read {path}: {error.strerror}") from error
    if len(content) > limit:
        raise ValueError("it is too long")
    return content


def read_json_object(path: Path, what: str, limit: int = MAX_JSON) -> dict[str, Any]:
    """Read a JSON file of at most ``limit`` bytes that should hold ``what``, an object.

    Raises:
        UserError: it is missing, damaged, or something else.
    """
    try:
        value = json.loads(read_small(path, limit))
        if not isinstance(value, dict):
            raise ValueError("it is no JSON object")
        # JSON can hold halves of characters, which no other file can.
        json.dumps(value, ensure_ascii=False).encode()
    except UserError:
        raise
    except (ValueError, RecursionError) as error:
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
    require_file(path)
    try:
        with (
            warnings.catch_warnings(action="ignore"),  # of headers written in strange ways
            path.open("rb") as file,
        ):
            archive = np.load(file, allow_pickle=False)
            if not isinstance(archive, np.lib.npyio.NpzFile):
                raise UserError(f"{path} is not a .npz file of {what}")
            missing = [name for name in fields if name not in archive.files]
            if missing:
                raise UserError(f"{path} has no {', '.join(missing)}: not a file of {what}")
            names = [*fields, *(name for name in optional if name in archive.files)]
            assert archive.zip is not None
            entries = {*names, *(f"{name}.npy" for name in names)}
            sizes = [x.file_size for x in archive.zip.infolist() if x.filename in entries]
            require_plausible(sum(sizes), path.stat().st_size, str(path))
            return {name: np.asarray(archive[name]) for name in names}
    except UserError:
        raise
    except Exception as error:  # damaged archives raise whatever their reader stumbles over
        reason = "it holds pickled objects" if "pickle" in str(error) else "it is damaged"
        raise UserError(f"{path} is not a .npz file of {what}: {reason}") from error


def require_plausible(size: int, file_size: int, source: str) -> None:
    """Raise UserError if what takes ``file_size`` bytes would fill the memory when unpacked.

    Numbers of the real world shrink to half; the zeros after the ends of short episodes to a
    thousandth, but only bombs hold nothing else in such numbers.
    """
    if size > max(SMALL, MAX_COMPRESSION * file_size):
        raise UserError(f"{source} would grow from {file_size:,} bytes to {size:,}: not read")


def require_name(name: str, source: str) -> str:
    """``name``, which is for people to read and to look up; UserError unless it can be one."""
    if not (0 < len(name) <= MAX_NAME and name.isprintable()):
        raise UserError(f"{source}: env_id is not the name of an environment")
    return name


def cache_directory() -> Path:
    """Where things are kept that can be made again."""
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base) / "ailsrs_jax"
