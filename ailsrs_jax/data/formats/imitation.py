"""Trajectories of the ``imitation`` library, as its ``data.serialize.save`` writes them."""

import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from ailsrs_jax.data.demonstrations import Demonstrations
from ailsrs_jax.data.episodes import make_episode, stack
from ailsrs_jax.errors import UserError, one_line
from ailsrs_jax.files import read_json_object, require_file

COLUMNS = ("obs", "acts", "rews", "terminal")  # "infos" is jsonpickle, and is never decoded


def load_imitation(
    directory: str | Path, env_id: str, num_trajectories: int | None = None
) -> tuple[Demonstrations, int]:
    """Read a directory of trajectories with rewards; nothing in it is ever unpickled.

    The format names neither the environment nor its time limit. A trajectory that is not
    ``terminal`` is a piece of an episode and is left out; any other ended in a terminal state or at
    the time limit, for which the length of the longest is taken.

    Args:
        directory: what ``imitation.data.serialize.save`` has written.
        env_id: the environment that they are of.
        num_trajectories: read no more than the first so many whole episodes.

    Returns:
        the demonstrations, and how many trajectories were left out.

    Raises:
        UserError: it is no such directory, pyarrow is not installed, or the contents contradict one
            another.
    """
    episodes, num_left_out = [], 0
    for index, row in enumerate(_rows(Path(directory))):
        where = f"{directory}: trajectory {index}"
        terminal = row["terminal"]
        if terminal.shape != () or terminal.dtype != bool:
            raise UserError(f"{where}: terminal is neither true nor false")
        episode = make_episode(row["obs"], row["acts"], row["rews"], where)
        if terminal:
            episodes.append(episode)
        else:
            num_left_out += 1
        if len(episodes) == num_trajectories:
            break
    if not episodes:
        raise UserError(f"{directory} holds no whole episode: {num_left_out} are cut off")
    longest = max(len(episode.actions) for episode in episodes)
    return stack(episodes, longest, env_id, str(directory)), num_left_out


def require_no_pickle(path: Path) -> None:
    """Raise UserError if the file ``path`` is of the library's older formats, which are pickled."""
    try:
        require_file(path)
        with path.open("rb") as file:
            pickled = file.read(1) == b"\x80"  # what every pickle since 2003 begins with
        if zipfile.is_zipfile(path):
            with zipfile.ZipFile(path) as archive:
                pickled = {"obs.npy", "acts.npy", "infos.npy"} <= set(archive.namelist())
    except Exception:  # whoever reads the file says what is wrong with it
        return
    if pickled:
        raise UserError(
            f"{path} is pickled, and never opened here; if you trust it, the imitation library "
            "converts it: from imitation.data import serialize; "
            f"serialize.save('DIRECTORY', serialize.load('{path}'))"
        )


def _rows(directory: Path) -> Iterator[dict[str, np.ndarray]]:
    """The trajectories, with their :data:`COLUMNS` as arrays."""
    try:
        import pyarrow as pa
    except ImportError:
        raise UserError(
            "trajectories of the imitation library need pip install 'ailsrs_jax[imitation]'"
        ) from None
    try:
        # The layout is that of the library "datasets", of which only Arrow's files are needed.
        state = read_json_object(directory / "state.json", "a list of files")
        names = [Path(file["filename"]).name for file in state["_data_files"]]
        if len(set(names)) < len(names):
            raise ValueError("a file is named twice")
    except (UserError, ValueError, KeyError, TypeError) as error:
        raise UserError(
            f"{directory} was not written by imitation.data.serialize.save: it has no state.json "
            "that names its files"
        ) from error
    for name in names:
        try:
            if not (directory / name).is_file():
                raise UserError(f"{directory} has no file {name}")
            with pa.memory_map(str(directory / name)) as file:
                table = pa.ipc.open_stream(file).read_all()
                table.validate(full=True)  # else offsets could point anywhere in memory
                missing = [column for column in COLUMNS if column not in table.column_names]
                if missing:
                    raise UserError(
                        f"{directory} has no {', '.join(missing)}: it does not hold the imitation "
                        "library's trajectories with rewards"
                    )
                for index in range(table.num_rows):
                    yield {column: _array(table[column][index]) for column in COLUMNS}
        except UserError:
            raise
        except Exception as error:  # damaged files raise whatever their reader stumbles over
            raise UserError(f"{directory} is damaged: {name}: {one_line(error)}") from error


def _array(cell: Any) -> np.ndarray:
    """What a scalar, a list or a list of lists of Arrow's holds."""
    values = getattr(cell, "values", None)
    if values is None:
        return np.asarray(cell.as_py())
    array = values.to_numpy(zero_copy_only=False)
    if array.dtype != object:
        return array
    try:
        return np.stack(array)
    except ValueError:  # ragged, which is a shape that nobody wants
        return array
