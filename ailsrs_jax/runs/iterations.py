"""The loop around a trainer's ``update``: compiled once, timed, reported."""

import time
from collections.abc import Callable, Iterator
from typing import Any

import jax
import numpy as np

from ailsrs_jax.runs.storage.metrics import IterationReport


def iterate(
    update: Callable[..., tuple[Any, dict[str, jax.Array]]],
    state: Any,
    env_steps: np.ndarray,
    start: int,
    num_iterations: int,
    *arguments: Any,
) -> Iterator[tuple[Any, IterationReport]]:
    """Apply ``update`` until ``num_iterations`` are done, and give state and report after each.

    Or until the state says of all seeds that they are ``finished``, where a trainer can tell.

    Args:
        update: of one seed; it is applied to all of them together.
        state: of all seeds, after ``start`` iterations.
        env_steps: ``(seeds,)`` int64, live steps simulated so far.
        start: iterations already done.
        num_iterations: when to stop.
        arguments: of ``update``, beside the state; of all seeds.
    """
    if start == num_iterations or _finished(state):
        return
    started = time.perf_counter()
    # Compiled ahead, so that it is timed apart, and so that it cannot be compiled again unseen.
    compiled = jax.jit(jax.vmap(update)).lower(state, *arguments).compile()
    compile_seconds = time.perf_counter() - started
    for iteration in range(start, num_iterations):
        started = time.perf_counter()
        state, device_metrics = compiled(state, *arguments)
        metrics = {name: np.asarray(values) for name, values in device_metrics.items()}
        finished = _finished(state)
        seconds = time.perf_counter() - started
        live_steps = metrics["env_steps"].astype(np.int64)  # exact beyond what int32 can count
        env_steps = env_steps + live_steps
        yield (
            state,
            IterationReport(
                iteration=iteration,
                num_iterations=num_iterations,
                metrics=metrics | {"env_steps": env_steps},
                seconds=seconds,
                env_steps_per_second=live_steps.sum() / seconds,
                compile_seconds=compile_seconds,
                finished=finished,
            ),
        )
        if finished:
            return


def _finished(state: Any) -> bool:
    return bool(np.all(getattr(state, "finished", False)))
