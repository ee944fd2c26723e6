"""MuJoCo's official WebAssembly build, which npm fetches once."""

import base64
import contextlib
import hashlib
import io
import shutil
import subprocess
import tarfile
import tempfile
from pathlib import Path
from typing import NamedTuple

from ailsrs_jax.errors import UserError
from ailsrs_jax.files import cache_directory, read_small, write_atomically

VERSION = "3.14.0"  # the newest build; another version needs another digest
PACKAGE = f"@mujoco/mujoco@{VERSION}"
ARCHIVE = f"mujoco-mujoco-{VERSION}.tgz"  # the name that npm gives it
SHA512 = "WPUYidu4Fx8+uM4hQv80SOA0ifpWGrsNJguKs8JBV8SCTxjKQ2/rqsh880nUH0/Vwa8vuefghvCQkkoed3bkUg=="
MOST_BYTES = 2**24  # of the archive, which has 5.5 million
SECONDS = 300  # that npm may take


class Build(NamedTuple):
    """The variant for one thread, which needs no special headers of a server."""

    script: str  # a module that ends in ``export default loadMujoco``
    program: bytes  # WebAssembly


def mujoco_build() -> Build:
    """Return the build, from the cache or else from npm. Its digest is checked.

    Raises:
        UserError: it is not in the cache, and npm is missing or cannot fetch it.
    """
    cached = cache_directory() / ARCHIVE
    archive = b""
    with contextlib.suppress(UserError, ValueError):  # missing, or something else
        archive = read_small(cached, MOST_BYTES)
    if not _is_right(archive):
        archive = _fetch()
        with contextlib.suppress(UserError):  # the page can be made without a cache, too
            write_atomically(cached, archive)
    with tarfile.open(fileobj=io.BytesIO(archive)) as files:
        script, program = (
            file.read()
            for name in ("mujoco.js", "mujoco.wasm")
            if (file := files.extractfile(f"package/{name}"))
        )
    return Build(script.decode(), program)


def _is_right(archive: bytes) -> bool:
    return base64.b64encode(hashlib.sha512(archive).digest()).decode() == SHA512


def _fetch() -> bytes:
    npm = shutil.which("npm")
    if npm is None:
        raise UserError(
            f"the page needs MuJoCo's WebAssembly build {PACKAGE}, which npm fetches: install "
            "npm, which is part of Node.js"
        )
    command = [npm, "pack", PACKAGE, "--loglevel=error", "--fetch-retries=1"]
    archive, why = b"", f"it takes more than {SECONDS} s"
    # In a directory of its own npm finds no project whose settings could change what it does.
    with (
        tempfile.TemporaryDirectory() as directory,
        contextlib.suppress(subprocess.TimeoutExpired, UserError, ValueError),
    ):
        ran = subprocess.run(
            command, cwd=directory, capture_output=True, text=True, timeout=SECONDS
        )
        why = next(iter(ran.stderr.splitlines()), "it is not there")
        archive = read_small(Path(directory, ARCHIVE), MOST_BYTES)
    if not archive:
        raise UserError(
            f"npm cannot fetch {PACKAGE} ({why}): the first page needs the internet, later ones "
            "do not"
        )
    if not _is_right(archive):
        raise UserError(
            f"npm has fetched another {PACKAGE} than was published: try again, or set another "
            "registry"
        )
    return archive
