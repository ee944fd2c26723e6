"""NumPy's ``.npz`` format: named arrays."""

import io
import warnings
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ailsrs_jax.errors import UserError
from ailsrs_jax.files import require_file, require_plausible


def encode_npz(arrays: Mapping[str, Any], *, compress: bool = False) -> bytes:
    """Return the bytes of a file that holds ``arrays``."""
    buffer = io.BytesIO()
    (np.savez_compressed if compress else np.savez)(buffer, **arrays)
    return buffer.getvalue()


def read_npz(
    path: Path, fields: tuple[str, ...], what: str, optional: tuple[str, ...] = ()
) -> dict[str, np.ndarray]:
    """Read the arrays ``fields``, and those of ``optional`` that the file has; unpickle nothing.

    Error messages call its content ``what``.

    Raises:
        UserError: the file is missing, damaged or pickled, or lacks a field.
    """
    require_file(path)
    try:
        with (
            warnings.catch_warnings(action="ignore"),  # about unusual headers
            path.open("rb") as file,
        ):
            archive = np.load(file, allow_pickle=False)
            if not isinstance(archive, np.lib.npyio.NpzFile):
                raise UserError(f"{path} is not a .npz file of {what}")
            names = present(archive.files, fields, optional, path, what)
            assert archive.zip is not None
            entries = {*names, *(f"{name}.npy" for name in names)}
            sizes = [x.file_size for x in archive.zip.infolist() if x.filename in entries]
            require_plausible(sum(sizes), path.stat().st_size, str(path))
            return {name: np.asarray(archive[name]) for name in names}
    except UserError:
        raise
    except Exception as error:  # NumPy raises many types of exception for damaged archives
        reason = "it holds pickled objects" if "pickle" in str(error) else "it is damaged"
        raise UserError(f"{path} is not a .npz file of {what}: {reason}") from error


def present(
    names: Collection[str],
    fields: tuple[str, ...],
    optional: tuple[str, ...],
    path: Path,
    what: str,
) -> list[str]:
    """Return ``fields``, and those of ``optional`` that are among the ``names`` in a file.

    Raises:
        UserError: one of ``fields`` is missing.
    """
    missing = [name for name in fields if name not in names]
    if missing:
        raise UserError(f"{path} has no {', '.join(missing)}: not a file of {what}")
    return [*fields, *(name for name in optional if name in names)]
