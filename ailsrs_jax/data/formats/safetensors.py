"""The ``safetensors`` format: named arrays and some text, and no code."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from ailsrs_jax.errors import UserError, one_line
from ailsrs_jax.files import require_file


def encode_safetensors(arrays: Mapping[str, np.ndarray], metadata: Mapping[str, str]) -> bytes:
    """The bytes of a file that holds ``arrays`` and ``metadata``."""
    from safetensors.numpy import save

    # It writes memory as it lies, whatever the strides say.
    contiguous = {name: np.ascontiguousarray(array) for name, array in arrays.items()}
    return save(contiguous, dict(metadata))


def read_safetensors(
    path: Path, fields: tuple[str, ...], what: str, optional: tuple[str, ...] = ()
) -> dict[str, np.ndarray]:
    """:func:`~ailsrs_jax.files.read_npz` of a ``.safetensors`` file; text is metadata there.

    Raises:
        UserError: it is missing, damaged, or lacks a field.
    """
    from safetensors import safe_open

    require_file(path)
    try:
        with safe_open(path, framework="numpy") as file:
            text = {name: np.array(value) for name, value in (file.metadata() or {}).items()}
            names = {*file.keys(), *text}
            missing = [name for name in fields if name not in names]
            if missing:
                raise UserError(f"{path} has no {', '.join(missing)}: not a file of {what}")
            return {
                name: text[name] if name in text else file.get_tensor(name)
                for name in (*fields, *optional)
                if name in names
            }
    except UserError:
        raise
    except Exception as error:  # of whatever kind, its reader's or NumPy's
        raise UserError(
            f"{path} is not a .safetensors file of {what}: {one_line(error)}"
        ) from error
