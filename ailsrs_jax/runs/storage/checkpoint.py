"""Saving and restoring the whole training state, with Orbax."""

import contextlib
import errno
import hashlib
import logging
import os
import re
import shutil
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import orbax.checkpoint as ocp

from ailsrs_jax.errors import UserError, one_line
from ailsrs_jax.files import read_small, write_atomically
from ailsrs_jax.runs.devices import anywhere, as_the_first_says, is_first_process

KEEP = 2  # so that one is whole while another is written
LISTED = 8  # that processes agree on
HASHES = "SHA256SUMS"  # in the format of the program sha256sum
OVERHEAD = 2**18  # bytes of a checkpoint beside its arrays

logger = logging.getLogger(__name__)


class Restored(NamedTuple):
    """A checkpoint that was read."""

    num_done: int  # iterations; 0 where there is no checkpoint
    state: Any
    about: dict[str, Any]  # what was to be written beside the state


class Checkpoints:
    """The checkpoints of one run; a context manager that finishes writing when it is left.

    Each is a directory ``N``, of the state after N iterations. Orbax writes it under another name,
    and renames it; then the hashes of its files are added, which make it a whole one. So a process
    that is killed leaves all of a checkpoint or none, and what a disk has damaged is not read:
    Orbax itself would take some of it for the state.
    """

    def __init__(
        self, directory: Path, save_every: int, about: dict[str, Any] | None = None
    ) -> None:
        """Keep the newest checkpoints under ``directory``, one every ``save_every`` iterations.

        ``about``, which JSON can hold, is written into each of them.

        Raises:
            UserError: the directory cannot be written.
        """
        self._directory = directory.absolute()
        self._save_every = save_every
        self._about = about or {}
        self._thread = ThreadPoolExecutor(1, "checkpoints")
        self._pending: Future[None] | None = None
        self._orbax_logger = logging.getLogger("absl")
        self._orbax_level = self._orbax_logger.level
        self._orbax_logger.setLevel(logging.CRITICAL)  # pages about each error that it raises too
        try:
            self._manager = ocp.CheckpointManager(
                self._directory,
                options=ocp.CheckpointManagerOptions(
                    max_to_keep=KEEP,
                    create=True,
                    cleanup_tmp_directories=True,  # those of killed processes
                ),
            )
            self._newest = max(filter(self._is_whole, self._manager.all_steps()), default=None)
        except OSError as error:
            raise self._cannot_write(error) from error

    def __enter__(self) -> "Checkpoints":
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        try:
            self._finish_writing()
        except UserError as problem:
            if error is None or isinstance(error, KeyboardInterrupt):  # which says that it is saved
                raise
            logger.warning("%s", problem)  # beside the error that is on its way already
        finally:
            self._thread.shutdown()
            with contextlib.suppress(Exception):  # what could not be written, once more
                self._manager.close()
            self._orbax_logger.setLevel(self._orbax_level)

    def is_due(self, num_done: int) -> bool:
        """Whether it is time to save, or the first time."""
        return self._newest is None or num_done % self._save_every == 0

    def save(self, num_done: int, state: Any) -> None:
        """Save the state after ``num_done`` iterations.

        It is copied at once, and written while the caller goes on.

        Raises:
            UserError: this or the one before cannot be written.
        """
        if num_done == self._newest:
            return
        self._finish_writing()
        packed = _pack(state)
        self._require_space(sum(leaf.nbytes for leaf in jax.tree.leaves(packed)))
        try:
            self._manager.save(
                num_done,
                args=ocp.args.Composite(
                    state=ocp.args.StandardSave(packed),
                    about=ocp.args.JsonSave(self._about),
                ),
            )
        except Exception as error:  # the disk's, as told by the layers between
            raise self._cannot_write(error) from error
        self._newest = num_done
        self._pending = self._thread.submit(self._seal, num_done)

    def restore(self, like: Any) -> Restored:
        """The newest checkpoint that is whole, its state shaped and placed ``like`` this one.

        Newer ones that are damaged are removed, with a warning. Without any, 0 and ``like`` itself.

        Raises:
            UserError: there are checkpoints, and none of them can be read.
        """
        problems: dict[int, Exception] = {}
        restored = Restored(0, like, {})
        # Unless it is whole, the process was killed before it was.
        whole = sorted(filter(self._is_whole, self._manager.all_steps()), reverse=True)
        for num_done in as_the_first_says(whole[:LISTED], LISTED):
            problem = self._problem(num_done, like)
            if not anywhere(problem is not None):
                try:
                    restored = self._read(num_done, like)
                    break
                except Exception as error:  # of damaged files it may be any
                    problem = error
            problems[num_done] = problem or ValueError("another process cannot read it")
        if problems and restored.num_done == 0:
            newest = one_line(next(iter(problems.values())))
            raise UserError(
                f"no checkpoint in {self._directory} can be read ({newest}): delete them to begin "
                "anew"
            )
        if problems and is_first_process():
            damaged = " and ".join(map(str, problems))
            logger.warning(
                "checkpoint %s in %s is damaged: going on from %d",
                damaged,
                self._directory,
                restored.num_done,
            )
        newer = [step for step in self._manager.all_steps() if step > restored.num_done]
        for num_done in as_the_first_says(newer[:LISTED], LISTED):
            self._manager.delete(num_done)
        self._newest = restored.num_done or None
        return restored

    def _is_whole(self, num_done: int) -> bool:
        return (self._directory / str(num_done) / HASHES).exists()

    def _problem(self, num_done: int, like: Any) -> Exception | None:
        """Why it cannot be read, if so: asked before, because Orbax reads with all processes."""
        directory = self._directory / str(num_done)
        try:
            if read_small(directory / HASHES).decode() != _hashes(directory):
                raise ValueError(f"its files are not those of {HASHES}")
            with ocp.StandardCheckpointer() as reader:
                saved = reader.metadata(directory / "state").item_metadata.tree
            if _shapes(saved) != _shapes(_abstract(like)):
                raise ValueError("its state has other arrays")
        except Exception as error:  # of damaged files it may be any
            return error
        return None

    def _read(self, num_done: int, like: Any) -> Restored:
        restored = self._manager.restore(
            num_done,
            args=ocp.args.Composite(
                state=ocp.args.StandardRestore(_abstract(like)), about=ocp.args.JsonRestore()
            ),
        )
        return Restored(num_done, _unpack(restored.state, like), dict(restored.about))

    def _seal(self, num_done: int) -> None:
        """Wait until the checkpoint is written, and declare it whole."""
        self._manager.wait_until_finished()
        if is_first_process():
            directory = self._directory / str(num_done)
            hashes = _hashes(directory).encode()
            write_atomically(directory / HASHES, lambda file: file.write(hashes))

    def _finish_writing(self) -> None:
        pending, self._pending = self._pending, None
        if pending is None:
            return
        try:
            pending.result()
        except UserError:
            raise
        except Exception as error:  # the disk's, as told by the layers between
            raise self._cannot_write(error) from error

    def _require_space(self, size: int) -> None:
        """Raise UserError if a full disk is foreseeable: Orbax's threads would print tracebacks."""
        try:
            free = shutil.disk_usage(self._directory).free
        except OSError as error:
            raise self._cannot_write(error) from error
        if free < size + OVERHEAD:
            raise self._cannot_write(OSError(errno.ENOSPC, os.strerror(errno.ENOSPC)))

    def _cannot_write(self, error: Exception) -> UserError:
        code = re.search(r"os_error_code='(\d+)'", str(error))  # at the end of a very long line
        reason = os.strerror(int(code[1])) if code else getattr(error, "strerror", None)
        return UserError(f"cannot write {self._directory}: {reason or one_line(error)}")


def _hashes(directory: Path) -> str:
    lines = []
    for path in sorted(directory.rglob("*")):
        if path.is_file() and path != directory / HASHES:
            with path.open("rb") as file:
                digest = hashlib.file_digest(file, "sha256").hexdigest()
            lines.append(f"{digest}  {path.relative_to(directory)}\n")
    return "".join(lines)


def _shapes(tree: Any) -> dict[str, Any]:
    """The shape and type of each array, by its name: Orbax reads named tuples as dictionaries."""
    leaves, _ = jax.tree.flatten_with_path(tree)
    names = (jax.tree_util.keystr(path, simple=True, separator=".") for path, _ in leaves)
    return {
        name: (leaf.shape, jnp.dtype(leaf.dtype))
        for name, (_, leaf) in zip(names, leaves, strict=True)
    }


def _abstract(like: Any) -> Any:
    """Shapes, types and places of what is written of ``like``."""
    return jax.tree.map(ocp.utils.to_shape_dtype_struct, _pack(like))


def _is_key(x: jax.Array) -> bool:
    return jnp.issubdtype(x.dtype, jax.dtypes.prng_key)


def _pack(state: Any) -> Any:
    """Random keys as the numbers they are made of."""
    return jax.tree.map(lambda x: jax.random.key_data(x) if _is_key(x) else x, state)


def _unpack(packed: Any, like: Any) -> Any:
    return jax.tree.map(
        lambda x, target: jax.random.wrap_key_data(x) if _is_key(target) else x, packed, like
    )
