"""Gradient descent as one scan."""

from collections.abc import Callable
from typing import Any

import jax
import optax

from ailsrs_jax.components.finite import finite_or


def descend(
    optimizer: optax.GradientTransformation,
    loss: Callable[[Any, Any], tuple[jax.Array, Any]],
    parameters: Any,
    optimizer_state: optax.OptState,
    batches: Any,
) -> tuple[Any, optax.OptState, Any]:
    """Take one step of ``optimizer`` for each of ``batches``, arrays whose first axis is the step.

    ``loss(parameters, batch)`` gives a loss to minimise and a pytree to report.

    Returns:
        Parameters and optimizer state, those from the start if new ones are not finite; and the
        reports of all steps.
    """

    def step(state: tuple[Any, optax.OptState], batch: Any) -> tuple[Any, Any]:
        parameters, optimizer_state = state
        gradients, report = jax.grad(loss, has_aux=True)(parameters, batch)
        updates, optimizer_state = optimizer.update(gradients, optimizer_state, parameters)
        return (optax.apply_updates(parameters, updates), optimizer_state), report

    start = parameters, optimizer_state
    end, reports = jax.lax.scan(step, start, batches)
    return *finite_or(end, start), reports
