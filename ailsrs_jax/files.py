"""Reading files that may be damaged or hostile, and writing files atomically."""

import contextlib
import json
import os
import secrets
import stat
from pathlib import Path
from typing import Any

from ailsrs_jax.errors import UserError, os_errors, refusing

MAX_JSON = 2**20  # bytes; this package's own files have a few thousand
MAX_NAME = 200  # characters
SMALL = 2**28  # bytes, which any machine has
MAX_COMPRESSION = 100
PARTIAL = ".partial"  # suffix of the hidden file of a process that is killed while it writes


def write_atomically(path: str | Path, content: bytes | str) -> None:
    """Write ``content`` to a temporary file beside the file ``path``, and rename it to that file.

    A link stays a link, and its target is written. A new file has the permissions that the umask
    leaves; a file that is there keeps its own.

    Raises:
        UserError: there is something else than a regular file, or the file cannot be written.
    """
    path = Path(path)
    with os_errors(f"cannot write {path}"):
        target = _followed(path)
        target.parent.mkdir(parents=True, exist_ok=True)
        temporary = target.with_name(f".{target.name}.{secrets.token_hex(4)}{PARTIAL}")
        with temporary.open("xb") as file:
            try:
                file.write(content.encode() if isinstance(content, str) else content)
                file.flush()
                os.fsync(file.fileno())
                if target.exists():
                    temporary.chmod(stat.S_IMODE(target.stat().st_mode))
                temporary.replace(target)
            except BaseException:
                temporary.unlink()
                raise


def write_json(path: Path, value: Any) -> None:
    """Write ``value`` as JSON, atomically; :func:`read_json_object` reads an object.

    Raises:
        UserError: the file cannot be written.
    """
    write_atomically(path, f"{json.dumps(value, indent=2)}\n")


def require_writable(path: Path) -> None:
    """Raise UserError unless a file can be written at ``path``; called before a long run."""
    with os_errors(f"cannot write {path}"):
        folder = _followed(path).parent
        while not folder.exists():
            folder = folder.parent
        writable = folder.is_dir() and os.access(folder, os.W_OK)
    if not writable:
        raise UserError(f"cannot write {path}")


def _followed(path: Path) -> Path:
    """Return the file to which links lead from ``path``; it need not exist.

    Raises:
        UserError: there is something else than a regular file.
        OSError: the links lead in a circle, or a folder is a file.
    """
    with contextlib.suppress(FileNotFoundError):
        if not stat.S_ISREG(path.stat().st_mode):
            raise UserError(f"cannot write {path}: it is not a regular file")
    return path.resolve()


def require_file(path: Path) -> None:
    """Raise UserError unless ``path`` is a regular file; reading a pipe or device could block."""
    with refusing(f"cannot read {path}"):
        is_there, is_file = path.exists(), path.is_file()
    if not is_there:
        raise UserError(f"no such file: {path}")
    if not is_file:
        raise UserError(f"{path} is not a file")


def read_small(path: Path, limit: int = MAX_JSON) -> bytes:
    """Read a file of at most ``limit`` bytes.

    Raises:
        UserError: it is not a regular file, or cannot be read.
        ValueError: it is longer.
    """
    require_file(path)
    with os_errors(f"cannot read {path}"), path.open("rb") as file:
        content = file.read(limit + 1)
    if len(content) > limit:
        raise ValueError("it is too long")
    return content


def read_json_object(path: Path, what: str, limit: int = MAX_JSON) -> dict[str, Any]:
    """Read a JSON file of at most ``limit`` bytes that should hold an object.

    Error messages call its content ``what``.

    Raises:
        UserError: the file is missing, damaged, or not a JSON object.
    """
    with refusing(f"{path} is not {what}"):
        value = json.loads(read_small(path, limit))
        if not isinstance(value, dict):
            raise ValueError("it is not a JSON object")
        # JSON can hold unpaired surrogates, which UTF-8 cannot.
        json.dumps(value, ensure_ascii=False).encode()
    return value


def read_json_if_there(path: Path, what: str) -> dict[str, Any] | None:
    """Read a file as :func:`read_json_object` does; return None if it is not there.

    Another process may remove it while it is read.
    """
    try:
        return read_json_object(path, what)
    except UserError:
        if os.path.lexists(path):
            raise
        return None


def require_plausible(size: int, file_size: int, source: str) -> None:
    """Raise UserError if ``file_size`` bytes would unpack to implausibly many, ``size``.

    Measured numbers compress to about half their size. The zeros after the ends of short episodes
    compress much more, but only a decompression bomb consists of nothing else and is that large.
    """
    if size > max(SMALL, MAX_COMPRESSION * file_size):
        raise UserError(
            f"{source} would grow from {file_size:,} bytes to {size:,}, so it is not read"
        )


def require_name(name: str, source: str) -> str:
    """Return ``name`` if it can be the name of an environment.

    Raises:
        UserError: it is empty, too long, or not printable.
    """
    if not (0 < len(name) <= MAX_NAME and name.isprintable()):
        raise UserError(f"{source}: env_id is not the name of an environment")
    return name


def cache_directory() -> Path:
    """Return the directory of files that can be made again."""
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base) / "ailsrs_jax"
