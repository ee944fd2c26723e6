"""A policy's file: its fields, and the formats in which they are stored."""

import importlib.util
import itertools
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ailsrs_jax.data.formats.c_header import encode_c_header
from ailsrs_jax.data.formats.npz import encode_npz, read_npz
from ailsrs_jax.data.formats.onnx import encode_onnx
from ailsrs_jax.data.formats.safetensors import encode_safetensors, read_safetensors
from ailsrs_jax.errors import UserError, requirement
from ailsrs_jax.files import require_name

# The arrays that the file of any policy holds. A linear policy's file also holds ``weights``; a
# neural policy's also holds ``weights_<i>`` and ``biases_<i>`` of each layer i, and ``action_std``.
COMMON_ARRAYS = ("mean", "std", "action_low", "action_high")
MAX_LAYERS = 16
MLP_ARRAYS = (
    *(f"{kind}_{layer}" for kind in ("weights", "biases") for layer in range(MAX_LAYERS)),
    "action_std",
)

Layers = tuple[tuple[np.ndarray, np.ndarray], ...]  # weights (out, in), biases (out,) of each


class Format(NamedTuple):
    """A format of policy files."""

    package: str  # the package that it needs
    encode: Callable[[dict[str, np.ndarray], Layers, dict[str, str]], bytes]  # with text
    read: Callable[..., dict[str, np.ndarray]] | None  # like read_npz


FORMATS = {
    ".npz": Format("numpy", lambda arrays, _, text: encode_npz({**arrays, **text}), read_npz),
    ".safetensors": Format(
        "safetensors", lambda arrays, _, text: encode_safetensors(arrays, text), read_safetensors
    ),
    ".onnx": Format("onnx", encode_onnx, None),
    ".h": Format("numpy", encode_c_header, None),
}


def require_format(path: Path) -> Format:
    """Return the format that the suffix of ``path`` names.

    Raises:
        UserError: there is no such format, or its package is not installed.
    """
    if path.suffix not in FORMATS:
        raise UserError(f"{path}: the name of a policy's file ends in {', '.join(FORMATS)}")
    if importlib.util.find_spec(FORMATS[path.suffix].package) is None:
        raise UserError(f"{path}: {path.suffix} files need pip install 'ailsrs_jax[export]'")
    return FORMATS[path.suffix]


def read_policy(path: Path) -> dict[str, Any]:
    """Read and validate a policy's file; nothing is unpickled.

    A file with another suffix is read as ``.npz``. A neural policy's ``weights`` and ``biases`` are
    tuples of arrays.

    Raises:
        UserError: the file is missing, has another format, or its contents contradict one another.
    """
    read = require_format(path).read if path.suffix in FORMATS else read_npz
    if read is None:
        raise UserError(
            f"{path}: {path.suffix} is for other programs; read a .npz or .safetensors file"
        )
    arrays = read(path, (*COMMON_ARRAYS, "env_id"), "a policy", ("weights", *MLP_ARRAYS))
    env_id = arrays.pop("env_id")

    require = requirement(str(path))
    weights, biases, others = ["weights"], [], []
    if "weights" not in arrays:
        layers = range(sum(name.startswith("weights_") for name in arrays))
        weights, biases = ([f"{kind}_{i}" for i in layers] for kind in ("weights", "biases"))
        others = ["action_std"]
    missing = [name for name in (*weights, *biases, *others) if name not in arrays]
    if missing or not weights:
        raise UserError(f"{path} has no {', '.join(missing) or 'weights'}: not a file of a policy")
    require(env_id.ndim == 0 and env_id.dtype.kind == "U", "env_id is not a single string")
    require_name(str(env_id), str(path))
    matrices = [arrays[name] for name in weights]
    for matrix in matrices:
        require(matrix.ndim == 2, f"weights are {matrix.shape}, not (out, in)")
        require(matrix.size > 0, f"weights are {matrix.shape}: they are empty")
    for i, (a, b) in enumerate(itertools.pairwise(matrix.shape for matrix in matrices)):
        require(a[0] == b[1], f"layers {i} and {i + 1} are {a} and {b}: they do not fit")
    shapes = {f"biases_{i}": matrix.shape[:1] for i, matrix in enumerate(matrices)}
    shapes |= dict.fromkeys(("mean", "std"), matrices[0].shape[1:])
    shapes |= dict.fromkeys(("action_low", "action_high", "action_std"), matrices[-1].shape[:1])
    for name, array in arrays.items():
        shape = shapes.get(name, array.shape)
        require(array.shape == shape, f"{name} is {array.shape}, not {shape}")
        require(
            array.dtype in (np.float32, np.float64) and bool(np.isfinite(array).all()),
            f"{name} is not made of finite floating-point numbers",
        )
    require(bool((arrays["std"] > 0).all()), "std is not positive")
    fields: dict[str, Any] = {name: arrays[name] for name in (*COMMON_ARRAYS, *others)}
    fields["env_id"] = str(env_id)
    if not biases:
        return fields | {"weights": matrices[0]}
    return fields | {"weights": tuple(matrices), "biases": tuple(arrays[name] for name in biases)}
