"""Demonstrations from wherever they are: a file, a Minari dataset, another library's directory."""

from pathlib import Path
from typing import NamedTuple

from ailsrs_jax.data.demonstrations import Demonstrations, load_demonstrations, save_demonstrations
from ailsrs_jax.data.episodes import Recording, load_imitation, load_minari, save_minari
from ailsrs_jax.data.formats.imitation import require_no_pickle
from ailsrs_jax.data.formats.minari import require_new_minari
from ailsrs_jax.errors import UserError
from ailsrs_jax.files import require_writable

MINARI = "minari:"


class Source(NamedTuple):
    """Demonstrations, and what a run writes down of where they are from."""

    demonstrations: Demonstrations
    description: str


def open_source(source: str | Path, env_id: str, num_trajectories: int | None) -> Source:
    """Read demonstrations.

    Args:
        source: a ``.npz`` file, ``minari:DATASET_ID``, or a directory of the imitation library's.
        env_id: the environment that they should be of.
        num_trajectories: no more are needed; what has to be read whole may give more.

    Raises:
        UserError: they cannot be read, contradict one another, or are said to be of another
            environment; what a ``.npz`` file says is left to the caller.
    """
    name, path, num_left_out = str(source), Path(source), 0
    if name.startswith(MINARI):
        dataset_id = name.removeprefix(MINARI)
        demonstrations, num_left_out = load_minari(dataset_id, env_id, num_trajectories)
    elif _is_directory(path):
        demonstrations, num_left_out = load_imitation(path, env_id, num_trajectories)
    else:
        require_no_pickle(path)
        demonstrations = load_demonstrations(path)
    left_out = f" ({num_left_out} cut off, left out)" if num_left_out else ""
    return Source(demonstrations, f"{name}{left_out}")


def require_target(target: str, env_id: str) -> None:
    """Raise UserError unless :func:`save_recording` can write there: before a long run."""
    if target.startswith(MINARI):
        require_new_minari(target.removeprefix(MINARI), env_id)
    else:
        require_writable(Path(target))


def save_recording(recording: Recording, target: str) -> None:
    """Write a ``.npz`` file or, at ``minari:DATASET_ID``, a new Minari dataset.

    Raises:
        UserError: it cannot be written.
    """
    if target.startswith(MINARI):
        save_minari(recording, target.removeprefix(MINARI))
    else:
        save_demonstrations(recording.demonstrations, target)


def _is_directory(path: Path) -> bool:
    try:
        return path.is_dir()
    except OSError as error:
        raise UserError(f"cannot read {path}: {error.strerror}") from error
