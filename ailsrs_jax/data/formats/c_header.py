"""Multilayer perceptrons as a C header without dependencies, for controllers and simulators."""

from collections.abc import Mapping, Sequence

import numpy as np

TEMPLATE = """\
/* A policy for {env_id}, written by ailsrs_jax.

   policy_act reads {num_observations} observations and writes {num_actions} actions. A stochastic
   policy's action is the mean. */
#ifndef AILSRS_POLICY_H
#define AILSRS_POLICY_H

#include <math.h>

#define POLICY_NUM_OBSERVATIONS {num_observations}
#define POLICY_NUM_ACTIONS {num_actions}

{constants}

/* y = W x + b, of tanh(x) if it is the output of an earlier layer */
static void policy_layer(const double *weights, const double *biases, int num_in, int num_out,
                         int first, const double *x, double *y) {{
    for (int i = 0; i < num_out; i++) {{
        y[i] = biases[i];
        for (int j = 0; j < num_in; j++)
            y[i] += weights[i * num_in + j] * (first ? x[j] : tanh(x[j]));
    }}
}}

static void policy_act(const double *observation, double *action) {{
    double x[{widest}], y[{widest}];
    for (int i = 0; i < POLICY_NUM_OBSERVATIONS; i++)
        x[i] = (observation[i] - policy_mean[i]) / policy_std[i];
{layers}
    for (int i = 0; i < POLICY_NUM_ACTIONS; i++)
        action[i] = fmin(fmax(x[i], policy_action_low[i]), policy_action_high[i]);
}}

#endif
"""
LAYER = """\
    policy_layer(policy_weights_{index}, policy_biases_{index}, {num_in}, {num_out}, {first}, x, y);
    for (int i = 0; i < {num_out}; i++) x[i] = y[i];"""


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
    text = TEMPLATE.format(
        env_id=metadata["env_id"].replace("*", "?"),  # cannot end the comment
        num_observations=len(arrays["mean"]),
        num_actions=len(arrays["action_low"]),
        widest=max(len(arrays["mean"]), *(len(biases) for _, biases in layers)),
        constants="\n".join(_constant(name, array) for name, array in constants.items()),
        layers="\n".join(
            LAYER.format(
                index=index, num_in=weights.shape[1], num_out=len(biases), first=int(index == 0)
            )
            for index, (weights, biases) in enumerate(layers)
        ),
    )
    return text.encode()


def _constant(name: str, array: np.ndarray) -> str:
    numbers = ", ".join(repr(float(number)) for number in array.ravel())
    return f"static const double policy_{name}[{array.size}] = {{{numbers}}};"
