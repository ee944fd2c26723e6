"""Multilayer perceptrons as ONNX models, for programs that know nothing of this package."""

from collections.abc import Mapping, Sequence

import numpy as np

from ailsrs_jax.errors import UserError

INPUT = "observation"  # float32 (batch, n)
OUTPUT = "action"  # float32 (batch, p)
OPSET = 13  # of 2020, so that older runtimes read it too


def encode_onnx(
    layers: Sequence[tuple[np.ndarray, np.ndarray]],
    statistics: tuple[np.ndarray, np.ndarray],
    action_range: tuple[np.ndarray, np.ndarray],
    metadata: Mapping[str, str],
) -> bytes:
    """The bytes of a model of clip(perceptron((observation − mean) / std), low, high), in float32.

    Args:
        layers: weights ``(out, in)`` and biases ``(out,)``, with tanh between layers.
        statistics: mean and std of the observations, ``(n,)`` each.
        action_range: low and high, ``(p,)`` each.
        metadata: text that the model carries.

    Raises:
        UserError: a number is beyond float32.
    """
    import onnx

    arrays = dict(zip(("mean", "std", "action_low", "action_high"), (*statistics, *action_range)))
    nodes = [
        onnx.helper.make_node("Sub", [INPUT, "mean"], ["centred"]),
        onnx.helper.make_node("Div", ["centred", "std"], ["hidden_0"]),
    ]
    for index, (weights, biases) in enumerate(layers):
        hidden, names = f"hidden_{index}", (f"weights_{index}", f"biases_{index}")
        if index > 0:
            nodes.append(onnx.helper.make_node("Tanh", [hidden], [f"tanh_{index}"]))
            hidden = f"tanh_{index}"
        output = f"hidden_{index + 1}"
        nodes.append(onnx.helper.make_node("Gemm", [hidden, *names], [output], transB=1))
        arrays |= dict(zip(names, (weights, biases)))
    # Clip has one range for all actions.
    nodes += [
        onnx.helper.make_node("Max", [f"hidden_{len(layers)}", "action_low"], ["above_low"]),
        onnx.helper.make_node("Min", ["above_low", "action_high"], [OUTPUT]),
    ]
    with np.errstate(over="ignore", under="ignore"):
        arrays = {name: np.asarray(array, np.float32) for name, array in arrays.items()}
    if not all(np.isfinite(array).all() for array in arrays.values()) or not arrays["std"].all():
        raise UserError("the policy holds numbers that float32, which ONNX files use, cannot")
    sizes = {INPUT: len(arrays["mean"]), OUTPUT: len(arrays["action_low"])}
    inputs, outputs = (
        [onnx.helper.make_tensor_value_info(name, onnx.TensorProto.FLOAT, ["batch", size])]
        for name, size in sizes.items()
    )
    constants = [onnx.numpy_helper.from_array(array, name) for name, array in arrays.items()]
    opsets = [onnx.helper.make_opsetid("", OPSET)]
    model = onnx.helper.make_model(
        onnx.helper.make_graph(nodes, "policy", inputs, outputs, constants),
        opset_imports=opsets,
        ir_version=onnx.helper.find_min_ir_version_for(opsets),
        producer_name="ailsrs_jax",
    )
    onnx.helper.set_model_props(model, dict(metadata))
    onnx.checker.check_model(model, full_check=True)
    return model.SerializeToString()
