"""The iterations of a trainer: ``update`` is compiled once, timed and reported."""

import time
from collections.abc import Callable, Iterator
from typing import Any

import jax
import numpy as np

from ailsrs_jax.host_calls import host_errors
from ailsrs_jax.runs.storage.metrics import IterationReport


def iterate(
    update: Callable[..., tuple[Any, dict[str, jax.Array]]],
    state: Any,
    env_steps: np.ndarray,
    start: int,
    num_iterations: int,
    *arguments: Any,
    place: jax.sharding.Sharding | None = None,
    compiler_options: dict[str, str | bool] | None = None,
) -> Iterator[tuple[Any, IterationReport]]:
    """Apply ``update`` until ``num_iterations`` are done, and yield state and report after each.

    ``update`` takes the state of one lane, that is of one seed of one run, and that lane's part of
    ``arguments``; it is applied to all lanes at once. A state may have a field ``finished``; the
    iterations end early once it is true for all lanes. ``state`` is that after ``start``
    iterations, and ``env_steps (lanes,)`` int64 are the live steps until then. Results lie at
    ``place`` on the devices, so that ``update`` can take them again.

    Raises:
        Interrupted: an iteration has ended early, because somebody asked for a stop.
        UserError: the environment failed.
    """
    if start == num_iterations or finished(state).all():
        return
    program, compile_seconds = compiled(
        jax.vmap(update), state, *arguments, place=place, options=compiler_options
    )
    for iteration in range(start, num_iterations):
        started = time.perf_counter()
        with host_errors():
            state, device_metrics = program(state, *arguments)
            metrics = {name: np.asarray(values) for name, values in device_metrics.items()}
        is_over = bool(finished(state).all())
        seconds = time.perf_counter() - started
        live_steps = metrics["env_steps"].astype(np.int64)  # the sum can exceed 32 bits
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
                finished=is_over,
            ),
        )
        if is_over:
            return


def compiled(
    function: Callable[..., Any],
    *arguments: Any,
    place: jax.sharding.Sharding | None = None,
    options: dict[str, str | bool] | None = None,
) -> tuple[Callable[..., Any], float]:
    """Compile ``function`` for ``arguments``; return the program and the seconds it took.

    Ahead of time, which times it separately and rules out compiling again later. Its results lie at
    ``place``, and XLA has the ``options``.
    """
    started = time.perf_counter()
    jitted = jax.jit(function, out_shardings=place)
    program = jitted.lower(*arguments).compile(compiler_options=options)
    return program, time.perf_counter() - started


def finished(state: Any) -> np.ndarray:
    """Tell which lanes have finished; ``()`` False for states that never finish early."""
    return np.asarray(getattr(state, "finished", False))
