"""Functions on the host that a JAX program calls: their exceptions, and how they end early.

A compiled program cannot be interrupted, and JAX would log an exception of a function that it calls
and raise another in its place. So these functions ask :func:`interrupted` now and then, and
:func:`host_errors` raises what they have raised.
"""

import contextlib
import threading
from collections.abc import Callable, Iterator
from typing import Any

import jax
import numpy as np

POLL_SECONDS = 0.1  # how often functions on the host ask


class Interrupted(Exception):  # noqa: N818  (not an error)
    """A function on the host has ended early, without a result."""


_stops: list[Callable[[], bool]] = []  # one for each block of interruptible, in any thread
_problems: list[list[Exception]] = []  # one list for each block of host_errors
_turn = threading.RLock()  # of the thread whose blocks of host_errors these are


def host_call(function: Callable[..., Any], types: Any, *arguments: Any) -> Any:
    """Call ``function`` with NumPy arrays; it returns arrays of the ``types``.

    Within :func:`host_errors` an exception gives zeros, and is raised at the end of the block.
    """

    def call(*arguments: Any) -> Any:
        try:
            return function(*jax.tree.map(np.asarray, arguments))
        except Exception as error:
            if not _problems:
                raise
            _problems[-1].append(error)
            return zeros(types)

    return jax.pure_callback(call, types, *arguments)


def zeros(types: Any) -> Any:
    """Return zeros of these ``types``, as NumPy arrays."""
    return jax.tree.map(lambda each: np.zeros(each.shape, each.dtype), types)


@contextlib.contextmanager
def host_errors() -> Iterator[None]:
    """Raise the first exception of host functions in the block, which waits for their results.

    Blocks of two threads take turns, so that a failure reaches its own.
    """
    problems: list[Exception] = []
    with _turn:
        _problems.append(problems)
        try:
            yield
        finally:
            _remove(_problems, problems)
    if problems:
        raise problems[0]


@contextlib.contextmanager
def interruptible(stop: Callable[[], bool]) -> Iterator[None]:
    """Let host functions end early while ``stop`` returns true."""
    _stops.append(stop)
    try:
        yield
    finally:
        _remove(_stops, stop)


def interrupted() -> bool:
    """Whether somebody has asked for a stop."""
    return any(stop() for stop in _stops)


def _remove(those: list[Any], one: Any) -> None:
    """Remove ``one`` itself: two empty lists of problems are equal."""
    those[:] = [each for each in those if each is not one]
