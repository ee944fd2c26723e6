"""Multilayer perceptrons as a C header without dependencies, for controllers and simulators."""

from collections.abc import Mapping, Sequence
from importlib import resources

import jinja2
import numpy as np


def encode_c_header(
    arrays: Mapping[str, np.ndarray],
    layers: Sequence[tuple[np.ndarray, np.ndarray]],
    metadata: Mapping[str, str],
) -> bytes:
    """Encode clip(perceptron((observation − mean) / std), low, high) as C99 in float64.

    Args:
        arrays: as for :func:`~ailsrs_jax.data.formats.onnx.encode_onnx`.
        layers: in the same way.
        metadata: ``env_id``, the name of the task.
    """
    constants = {name: arrays[name] for name in ("mean", "std", "action_low", "action_high")}
    for index, (weights, biases) in enumerate(layers):
        constants |= {f"weights_{index}": weights, f"biases_{index}": biases}
    template = resources.files("ailsrs_jax.data.formats").joinpath("policy.h").read_text()
    text = jinja2.Template(template, trim_blocks=True, keep_trailing_newline=True).render(
        env_id=metadata["env_id"].replace("*", "?"),  # cannot end the comment
        sizes=[len(arrays["mean"]), *(len(biases) for _, biases in layers)],
        constants={name: x.astype(float).ravel().tolist() for name, x in constants.items()},
    )
    return text.encode()
