"""Sources of demonstrations: files, Minari datasets, directories of the imitation library."""

import dataclasses
import hashlib
import os
import reprlib
from pathlib import Path
from typing import Any

from ailsrs_jax.data.demonstrations import (
    Demonstrations,
    load_demonstrations,
    save_demonstrations,
    validated,
)
from ailsrs_jax.data.episodes import Recording, load_imitation, load_minari, save_minari
from ailsrs_jax.data.formats.imitation import require_no_pickle
from ailsrs_jax.data.formats.minari import require_new_minari
from ailsrs_jax.errors import UserError, os_errors
from ailsrs_jax.files import require_writable

MINARI = "minari:"
EXPERT = "expert:"
KINDS = ("expert", "file", "minari", "imitation", "memory")


@dataclasses.dataclass(frozen=True)
class Source:
    """Where demonstrations are from, as ``config.json`` records it.

    The name is a path, the id of a dataset, or one of :data:`~ailsrs_jax.data.policies.EXPERTS`.
    The default expert and demonstrations in memory have none.
    """

    kind: str  # one of KINDS
    name: str | None = None
    num_left_out: int = 0  # truncated episodes that were not read
    states_only: bool = False  # their actions are not used

    @property
    def argument(self) -> str | None:
        """What ``--demonstrations`` takes; None for the default expert and for memory."""
        if self.kind in ("expert", "minari") and self.name is not None:
            return f"{self.kind}:{self.name}"
        return self.name

    def __str__(self) -> str:
        """For people, after "10 demonstrations"."""
        if self.kind == "memory":
            told = "handed in from Python"
        elif self.kind == "expert":
            told = "of the expert that ships with the package"
            told += "" if self.name is None else f" ({self.argument})"
        else:
            told = str(self.argument)
        if self.num_left_out:
            episodes = "episode" if self.num_left_out == 1 else "episodes"
            told += f" ({self.num_left_out} truncated {episodes} left out)"
        return f"{told}, states alone" if self.states_only else told

    def described(self, number: int | None, every: int | None) -> str:
        """Describe, for people, ``number`` demonstrations with one step in ``every``."""
        steps = "" if every in (None, 1) else f", one step in {every}"
        return f"{number} demonstration{'s' * (number != 1)} {self}{steps}"


def parse_source(fields: Any, where: str) -> Source | None:
    """Return the source that the file ``where`` records; None if it records none.

    Raises:
        UserError: it is not such a record.
    """
    match fields:
        case None:
            return None
        case {"kind": str(kind), "name": str() | None as name, "num_left_out": int(count), **rest}:
            states_only = rest.pop("states_only", False)
            named = name is not None or kind in ("expert", "memory")
            valid = kind in KINDS and named and 0 <= count < 2**31 and not rest
            if valid and isinstance(states_only, bool):
                return Source(kind, name, count, states_only)
    raise UserError(f"{where}: source is {reprlib.repr(fields)}, not a source of demonstrations")


def open_source(
    demonstrations: str | Path | Demonstrations, env_id: str, num_trajectories: int | None = None
) -> tuple[Demonstrations, Source]:
    """Read and validate demonstrations.

    Args:
        demonstrations: a ``.npz`` file, ``minari:DATASET_ID``, a directory that the imitation
            library wrote, or demonstrations in memory.
        env_id: the environment that they should be of.
        num_trajectories: the number of episodes needed; formats that are read whole give more.

    Raises:
        UserError: they cannot be read, contradict themselves, or a dataset names another
            environment. Whether a ``.npz`` file fits the environment is left to the caller.
    """
    if isinstance(demonstrations, Demonstrations):
        checked = validated(vars(demonstrations), "the demonstrations handed in")
        return checked, Source("memory")
    argument, path = str(demonstrations), Path(demonstrations)
    # A file name can hold any bytes, but JSON and TOML can only hold text.
    name = os.fsencode(argument).decode(errors="backslashreplace")
    if argument.startswith(MINARI):
        read, num_left_out = load_minari(argument.removeprefix(MINARI), env_id, num_trajectories)
        return read, Source("minari", name.removeprefix(MINARI), num_left_out)
    with os_errors(f"cannot read {path}"):
        is_directory = path.is_dir()
    if is_directory:
        read, num_left_out = load_imitation(path, env_id, num_trajectories)
        return read, Source("imitation", name, num_left_out)
    require_no_pickle(path)
    return load_demonstrations(path), Source("file", name)


def content_hash(demonstrations: Demonstrations) -> str:
    """Return the SHA-256 of the arrays, which does not depend on the file format."""
    digest = hashlib.sha256()
    for name, array in demonstrations.fields().items():
        digest.update(f"{name} {array.dtype} {array.shape} ".encode() + array.tobytes())
    return digest.hexdigest()


def require_target(target: str, env_id: str) -> None:
    """Raise UserError unless :func:`save_recording` can write to ``target``."""
    if target.startswith(MINARI):
        require_new_minari(target.removeprefix(MINARI), env_id)
    else:
        require_writable(Path(target))


def save_recording(recording: Recording, target: str) -> None:
    """Write a ``.npz`` file or, for ``minari:DATASET_ID``, a new Minari dataset.

    Raises:
        UserError: it cannot be written.
    """
    if target.startswith(MINARI):
        save_minari(recording, target.removeprefix(MINARI))
    else:
        save_demonstrations(recording.demonstrations, target)
