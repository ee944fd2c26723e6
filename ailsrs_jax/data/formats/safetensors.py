"""The ``safetensors`` format: named arrays and some text, without code."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from ailsrs_jax.data.formats.npz import present
from ailsrs_jax.errors import refusing
from ailsrs_jax.files import require_file


def encode_safetensors(arrays: Mapping[str, np.ndarray], metadata: Mapping[str, str]) -> bytes:
    """Return the bytes of a file that holds ``arrays`` and ``metadata``."""
    from safetensors.numpy import save

    # The library writes the memory as it is and ignores the strides.
    contiguous = {name: np.ascontiguousarray(array) for name, array in arrays.items()}
    return save(contiguous, dict(metadata))


def read_safetensors(
    path: Path, fields: tuple[str, ...], what: str, optional: tuple[str, ...] = ()
) -> dict[str, np.ndarray]:
    """Read the same as :func:`~ailsrs_jax.data.formats.npz.read_npz`; the metadata hold the text.

    Raises:
        UserError: the file is missing or damaged, or lacks a field.
    """
    from safetensors import safe_open

    require_file(path)
    with (
        refusing(f"{path} is not a .safetensors file of {what}"),
        safe_open(path, framework="numpy") as file,
    ):
        text = {name: np.array(value) for name, value in (file.metadata() or {}).items()}
        names = present({*file.keys(), *text}, fields, optional, path, what)
        return {name: text[name] if name in text else file.get_tensor(name) for name in names}
