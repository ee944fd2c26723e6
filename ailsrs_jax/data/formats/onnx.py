"""Multilayer perceptrons as ONNX models, for programs that do not use this package."""

from collections.abc import Mapping, Sequence

import numpy as np

from ailsrs_jax.errors import UserError

INPUT = "observation"  # float32 (batch, n)
OUTPUT = "action"  # float32 (batch, p)
OPSET = 13  # of the year 2020, which older runtimes can read


def encode_onnx(
    arrays: Mapping[str, np.ndarray],
    layers: Sequence[tuple[np.ndarray, np.ndarray]],
    metadata: Mapping[str, str],
) -> bytes:
    """Encode the model clip(perceptron((observation − mean) / std), low, high) in float32.

    Args:
        arrays: mean and std of the observations, ``(n,)``; action_low and action_high, ``(p,)``.
        layers: weights ``(out, in)`` and biases ``(out,)`` of each layer, with tanh between layers.
        metadata: text to store in the model.

    Raises:
        UserError: a number does not fit into float32.
    """
    import onnx

    used = {name: arrays[name] for name in ("mean", "std", "action_low", "action_high")}
    nodes = [
        onnx.helper.make_node("Sub", [INPUT, "mean"], ["centred"]),
        onnx.helper.make_node("Div", ["centred", "std"], ["hidden_0"]),
    ]
    for index, layer in enumerate(layers):
        hidden, names = f"hidden_{index}", (f"weights_{index}", f"biases_{index}")
        if index > 0:
            nodes.append(onnx.helper.make_node("Tanh", [hidden], [f"tanh_{index}"]))
            hidden = f"tanh_{index}"
        output = f"hidden_{index + 1}"
        nodes.append(onnx.helper.make_node("Gemm", [hidden, *names], [output], transB=1))
        used |= zip(names, layer, strict=True)
    # ONNX's Clip supports only one range for all actions.
    nodes += [
        onnx.helper.make_node("Max", [f"hidden_{len(layers)}", "action_low"], ["above_low"]),
        onnx.helper.make_node("Min", ["above_low", "action_high"], [OUTPUT]),
    ]
    with np.errstate(over="ignore", under="ignore"):
        constants = {name: np.asarray(array, np.float32) for name, array in used.items()}
    finite = all(np.isfinite(array).all() for array in constants.values())
    if not finite or not constants["std"].all():
        raise UserError(
            "the policy holds numbers that do not fit into float32, which ONNX files use"
        )
    sizes = {INPUT: len(constants["mean"]), OUTPUT: len(constants["action_low"])}
    inputs, outputs = (
        [onnx.helper.make_tensor_value_info(name, onnx.TensorProto.FLOAT, ["batch", size])]
        for name, size in sizes.items()
    )
    tensors = [onnx.numpy_helper.from_array(array, name) for name, array in constants.items()]
    opsets = [onnx.helper.make_opsetid("", OPSET)]
    model = onnx.helper.make_model(
        onnx.helper.make_graph(nodes, "policy", inputs, outputs, tensors),
        opset_imports=opsets,
        ir_version=onnx.helper.find_min_ir_version_for(opsets),
        producer_name="ailsrs_jax",
    )
    onnx.helper.set_model_props(model, dict(metadata))
    onnx.checker.check_model(model, full_check=True)
    return model.SerializeToString()
