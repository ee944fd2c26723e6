"""Saving and restoring the whole training state, with Orbax."""

from pathlib import Path
from types import TracebackType
from typing import Any

import jax
import jax.numpy as jnp
import orbax.checkpoint as ocp

from ailsrs_jax.errors import UserError

KEEP = 2  # so that one is whole while another is written


class Checkpoints:
    """The checkpoints of one run; a context manager that finishes writing when it is left."""

    def __init__(self, directory: Path, save_every: int) -> None:
        """Keep checkpoints under ``directory``, one every ``save_every`` iterations."""
        try:
            self._manager = ocp.CheckpointManager(
                directory.absolute(),
                options=ocp.CheckpointManagerOptions(
                    max_to_keep=KEEP, save_interval_steps=save_every, create=True
                ),
            )
        except OSError as error:
            raise UserError(f"cannot write {directory}: {error.strerror}") from error

    def __enter__(self) -> "Checkpoints":
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self._manager.close()  # waits for what is being written

    def save(self, num_done: int, state: Any, *, force: bool = False) -> None:
        """Save the state after ``num_done`` iterations, if it is time or by ``force``."""
        if num_done in self._manager.all_steps():
            return
        try:
            self._manager.save(num_done, args=ocp.args.StandardSave(_pack(state)), force=force)
        except OSError as error:
            raise UserError(f"cannot write {self._manager.directory}: {error.strerror}") from error

    def restore(self, like: Any) -> tuple[int, Any]:
        """The newest checkpoint: iterations done and the state, shaped ``like`` this one.

        Without any, 0 and ``like`` itself.
        """
        num_done = self._manager.latest_step()
        if num_done is None:
            return 0, like
        abstract = jax.tree.map(ocp.utils.to_shape_dtype_struct, _pack(like))
        try:
            restored = self._manager.restore(num_done, args=ocp.args.StandardRestore(abstract))
        except (OSError, ValueError) as error:
            raise UserError(
                f"cannot read checkpoint {num_done} in {self._manager.directory}: it is damaged; "
                "delete it to go on from the one before"
            ) from error
        return num_done, _unpack(restored, like)


def _is_key(x: jax.Array) -> bool:
    return jnp.issubdtype(x.dtype, jax.dtypes.prng_key)


def _pack(state: Any) -> Any:
    """Random keys as the numbers they are made of."""
    return jax.tree.map(lambda x: jax.random.key_data(x) if _is_key(x) else x, state)


def _unpack(packed: Any, like: Any) -> Any:
    return jax.tree.map(
        lambda x, target: jax.random.wrap_key_data(x) if _is_key(target) else x, packed, like
    )
