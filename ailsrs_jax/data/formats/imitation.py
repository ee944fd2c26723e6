"""Trajectories of the ``imitation`` library, as its ``data.serialize.save`` writes them."""

import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from ailsrs_jax.data.formats.episodes import Episode, make_episode
from ailsrs_jax.errors import UserError, refusing
from ailsrs_jax.files import read_json_object, require_file

COLUMNS = ("obs", "acts", "rews", "terminal")  # "infos" is jsonpickle, and is never decoded


def read_imitation(directory: Path) -> Iterator[tuple[Episode, bool]]:
    """Yield each trajectory, and whether it is a whole episode.

    Raises:
        UserError: see :func:`~ailsrs_jax.load_imitation`.
    """
    for index, row in enumerate(_rows(directory)):
        where = f"{directory}: trajectory {index}"
        terminal = row["terminal"]
        if terminal.shape != () or terminal.dtype != bool:
            raise UserError(f"{where}: terminal is neither true nor false")
        yield make_episode(row["obs"], row["acts"], row["rews"], where), bool(terminal)


def require_no_pickle(path: Path) -> None:
    """Raise UserError if the file ``path`` has one of the library's older, pickled formats."""
    try:
        require_file(path)
        with path.open("rb") as file:
            pickled = file.read(1) == b"\x80"  # the first byte of every pickle since 2003
        if zipfile.is_zipfile(path):
            with zipfile.ZipFile(path) as archive:
                pickled = {"obs.npy", "acts.npy", "infos.npy"} <= set(archive.namelist())
    except Exception:  # the caller reads the file next and reports its damage
        return
    if pickled:
        raise UserError(
            f"{path} is pickled and is not opened; if you trust it, convert it with the imitation "
            "library: from imitation.data import serialize; "
            f"serialize.save('DIRECTORY', serialize.load('{path}'))"
        )


def _rows(directory: Path) -> Iterator[dict[str, np.ndarray]]:
    """Yield the :data:`COLUMNS` of each trajectory as arrays."""
    try:
        import pyarrow as pa
    except ImportError:
        raise UserError(
            "trajectories of the imitation library need pip install 'ailsrs_jax[imitation]'"
        ) from None
    try:
        # The layout is that of the library "datasets"; only its Arrow files are needed.
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
        with refusing(f"{directory} is damaged: {name}"):
            if not (directory / name).is_file():
                raise UserError(f"{directory} has no file {name}")
            with pa.memory_map(str(directory / name)) as file:
                table = pa.ipc.open_stream(file).read_all()
                table.validate(full=True)  # otherwise offsets could point anywhere
                missing = [column for column in COLUMNS if column not in table.column_names]
                if missing:
                    raise UserError(
                        f"{directory} has no {', '.join(missing)}: it does not hold the imitation "
                        "library's trajectories with rewards"
                    )
                for index in range(table.num_rows):
                    yield {column: _array(table[column][index]) for column in COLUMNS}


def _array(cell: Any) -> np.ndarray:
    """Convert an Arrow scalar, list or list of lists to an array."""
    values = getattr(cell, "values", None)
    if values is None:
        return np.asarray(cell.as_py())
    array = values.to_numpy(zero_copy_only=False)
    if array.dtype != object:
        return array
    try:
        return np.stack(array)
    except ValueError:  # ragged lists, whose shape is refused later
        return array
