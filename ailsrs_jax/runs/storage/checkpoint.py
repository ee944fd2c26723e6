"""Save and restore the whole training state, with Orbax."""

import contextlib
import errno
import hashlib
import logging
import os
import re
import resource
import shutil
import time
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import orbax.checkpoint as ocp

from ailsrs_jax.errors import UserError, one_line
from ailsrs_jax.files import read_small, write_atomically
from ailsrs_jax.runs.storage.processes import anywhere, as_the_first_says, is_first_process

EVERY = 10  # iterations from a checkpoint to the next, if no rest is needed
PAUSE = 1.0  # shortest rest after a checkpoint [s]
SHARE = 0.1  # largest share of the time in which saving may stop the training
KEEP = 2  # so that one is complete while another is written
HASHES = "SHA256SUMS"  # in the format of the program sha256sum
OVERHEAD = 2**18  # bytes of a checkpoint beside its arrays

logger = logging.getLogger(__name__)


class Restored(NamedTuple):
    """A checkpoint that was read."""

    num_done: int  # iterations; 0 if there was no checkpoint
    state: Any
    about: dict[str, Any]  # was saved with the state


class Checkpoints:
    """The checkpoints of a run; a context manager that finishes writing when it is left.

    The state after N iterations is in the directory ``N``. Orbax writes it under a temporary name
    and renames it, and then we add the hashes of its files, which mark it as complete. A process
    that is killed therefore leaves a complete checkpoint or none. The hashes also detect damage by
    the disk, which Orbax would partly accept. The methods raise UserError if this checkpoint or the
    previous one cannot be written.
    """

    def __init__(
        self, directory: Path, save_every: int | None = None, about: dict[str, Any] | None = None
    ) -> None:
        """Keep the newest checkpoints under ``directory``, one every ``save_every`` iterations.

        With None, it is every ten iterations that are not within the rest after a checkpoint, see
        :meth:`rest`. ``about`` are values that JSON can hold, saved with every checkpoint.
        """
        self._directory = directory.absolute()
        self._save_every, self._resting_until = save_every, 0.0
        self._about = about or {}
        self._thread = ThreadPoolExecutor(1, "checkpoints")
        self._pending: Future[None] | None = None
        self._orbax_logger = logging.getLogger("absl")
        self._orbax_level = self._orbax_logger.level
        self._orbax_logger.setLevel(logging.CRITICAL)  # it logs pages for each error raised
        options = ocp.CheckpointManagerOptions(
            max_to_keep=KEEP,
            create=True,
            cleanup_tmp_directories=True,  # left by killed processes
        )
        with self._writing():
            self._manager = ocp.CheckpointManager(self._directory, options=options)
            self._newest = max(self._complete(), default=None)

    def __enter__(self) -> "Checkpoints":
        return self

    def __exit__(self, _: object, error: BaseException | None, *traceback: object) -> None:
        try:
            self._finish_writing()
        except UserError as problem:
            # After KeyboardInterrupt the user is told that the run is saved.
            if error is None or isinstance(error, KeyboardInterrupt):
                raise
            logger.warning("%s", problem)
        finally:
            self._thread.shutdown()
            with contextlib.suppress(Exception):  # raises the error of writing again
                self._manager.close()
            self._orbax_logger.setLevel(self._orbax_level)

    def is_due(self, num_done: int) -> bool:
        """Whether to save after ``num_done`` iterations: the first time, and every so often."""
        if self._newest is None:
            return True
        if self._save_every is not None:
            return num_done % self._save_every == 0
        return num_done % EVERY == 0 and not anywhere(time.monotonic() < self._resting_until)

    def rest(self, began: float) -> None:
        """Rest after a checkpoint, whose saving ``began`` at this time of the monotonic clock.

        The rest takes at least a second, and nine times as long as training has been stopped.
        """
        now = time.monotonic()
        self._resting_until = now + max(PAUSE, (1 / SHARE - 1) * (now - began))

    def save(self, num_done: int, state: Any) -> None:
        """Copy the state after ``num_done`` iterations, and write it in the background."""
        if num_done == self._newest:
            return
        self._finish_writing()
        packed = _pack(state)
        size = sum(leaf.nbytes for leaf in jax.tree.leaves(packed))
        args = ocp.args.Composite(
            state=ocp.args.StandardSave(packed), about=ocp.args.JsonSave(self._about)
        )
        with self._writing():
            # Where there is no room, the threads of Orbax would print tracebacks.
            if shutil.disk_usage(self._directory).free < size + OVERHEAD:
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            longest = resource.getrlimit(resource.RLIMIT_FSIZE)[0]  # of a file; -1: any
            if 0 <= longest < size + OVERHEAD:
                raise OSError(errno.EFBIG, os.strerror(errno.EFBIG))
            self._manager.save(num_done, args=args)
        self._newest = num_done
        self._pending = self._thread.submit(self._seal, num_done)

    def restore(self, like: Any) -> Restored:
        """Read the newest complete checkpoint, with shapes and devices as in the state ``like``.

        Damaged newer ones are removed, with a warning. Without checkpoints, return 0 and ``like``.

        Raises:
            UserError: there are checkpoints, but none can be read.
        """
        problems: dict[int, Exception] = {}
        restored = Restored(0, like, {})
        for num_done in as_the_first_says(sorted(self._complete(), reverse=True)):
            problem = self._problem(num_done, like)
            if not anywhere(problem is not None):
                try:
                    restored = self._read(num_done, like)
                    break
                except Exception as error:  # damaged files raise anything
                    problem = error
            problems[num_done] = problem or ValueError("another process cannot read it")
        if problems and restored.num_done == 0:
            newest = one_line(next(iter(problems.values())))
            raise UserError(
                f"no checkpoint in {self._directory} can be read ({newest}): delete them to start "
                "over"
            )
        if problems and is_first_process():
            logger.warning(
                "checkpoint %s in %s is damaged: resuming from %d",
                " and ".join(map(str, problems)),
                self._directory,
                restored.num_done,
            )
        newer = [step for step in self._manager.all_steps() if step > restored.num_done]
        for num_done in as_the_first_says(newer):
            self._manager.delete(num_done)
        self._newest = restored.num_done or None
        return restored

    def _complete(self) -> list[int]:
        """Return the checkpoints that were written to the end."""
        steps = self._manager.all_steps()
        return [step for step in steps if (self._directory / str(step) / HASHES).exists()]

    def _problem(self, num_done: int, like: Any) -> Exception | None:
        """Return why a checkpoint cannot be read; None if it can.

        This is checked first, because Orbax reads with all processes at once.
        """
        directory = self._directory / str(num_done)
        try:
            if read_small(directory / HASHES).decode() != _hashes(directory):
                raise ValueError(f"its files are not those of {HASHES}")
            with ocp.StandardCheckpointer() as reader:
                saved = reader.metadata(directory / "state").item_metadata.tree
            if _shapes(saved) != _shapes(_abstract(like)):
                raise ValueError("its state has other arrays")
        except Exception as error:  # damaged files raise anything
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
        """Wait until the checkpoint is written, and mark it as complete."""
        self._manager.wait_until_finished()
        if is_first_process():
            directory = self._directory / str(num_done)
            write_atomically(directory / HASHES, _hashes(directory))

    def _finish_writing(self) -> None:
        pending, self._pending = self._pending, None
        if pending is not None:
            with self._writing():
                pending.result()

    @contextlib.contextmanager
    def _writing(self) -> Iterator[None]:
        """Turn an error of the disk, which Orbax wraps in various types, into a UserError."""
        try:
            yield
        except UserError:
            raise
        except Exception as error:
            code = re.search(r"os_error_code='(\d+)'", str(error))  # the end of a very long line
            reason = os.strerror(int(code[1])) if code else getattr(error, "strerror", None)
            raise UserError(
                f"cannot write {self._directory}: {reason or one_line(error)}"
            ) from error


def _hashes(directory: Path) -> str:
    lines = []
    for path in sorted(directory.rglob("*")):
        if path.is_file() and path != directory / HASHES:
            with path.open("rb") as file:
                digest = hashlib.file_digest(file, "sha256").hexdigest()
            lines.append(f"{digest}  {path.relative_to(directory)}\n")
    return "".join(lines)


def _shapes(tree: Any) -> dict[str, Any]:
    """Return shape and type of each array by name, since Orbax reads named tuples as dicts."""
    return {
        jax.tree_util.keystr(path, simple=True, separator="."): (x.shape, jnp.dtype(x.dtype))
        for path, x in jax.tree.leaves_with_path(tree)
    }


def _abstract(like: Any) -> Any:
    """Return shapes, types and devices of the arrays that are written."""
    return jax.tree.map(ocp.utils.to_shape_dtype_struct, _pack(like))


def _is_key(x: jax.Array) -> bool:
    return jnp.issubdtype(x.dtype, jax.dtypes.prng_key)


def _pack(state: Any) -> Any:
    """Replace random keys by their numbers, which Orbax can write."""
    return jax.tree.map(lambda x: jax.random.key_data(x) if _is_key(x) else x, state)


def _unpack(packed: Any, like: Any) -> Any:
    return jax.tree.map(
        lambda x, target: jax.random.wrap_key_data(x) if _is_key(target) else x, packed, like
    )
