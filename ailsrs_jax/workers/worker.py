"""The program of a worker: ``python -m ailsrs_jax.workers.worker FILE_DESCRIPTOR``.

It reads requests from the file descriptor and writes answers to it. It ends when the other side is
closed, also in the middle of an episode, so that it does not outlive the program that started it.
"""

import os
import queue
import signal
import sys
import threading
import traceback
from collections.abc import Callable
from multiprocessing.connection import Connection
from typing import Any, NamedTuple

import cloudpickle

from ailsrs_jax.errors import one_line
from ailsrs_jax.workers.segment import Environments


class Failure(NamedTuple):
    """The answer if the environment has raised an exception."""

    line: str
    traceback: str


def attempt(function: Callable[[], Any]) -> Any:
    """Return what ``function`` returns, or a :class:`Failure`."""
    try:
        return function()
    except Exception as error:
        return Failure(one_line(error), traceback.format_exc())


def serve(connection: Connection) -> None:
    """Make an environment, then run episodes and segments.

    The first request is ``sys.path``, with which all others are unpickled; the second is the name
    of the environment.
    """
    requests: queue.SimpleQueue[bytes] = queue.SimpleQueue()

    def receive() -> None:
        try:
            while True:
                requests.put(connection.recv_bytes())
        finally:
            os.killpg(0, signal.SIGKILL)  # this process, and those that the environment has started

    def load() -> Any:
        return cloudpickle.loads(requests.get())

    threading.Thread(target=receive, daemon=True).start()
    sys.path[:] = load()
    envs = attempt(lambda: Environments(load()))
    connection.send(envs if isinstance(envs, Failure) else envs.facts)
    while True:
        connection.send(attempt(lambda: envs.answer(load())))


if __name__ == "__main__":
    # A module that is run is another than the one that is imported, and so are its classes.
    from ailsrs_jax.workers import worker

    worker.serve(Connection(int(sys.argv[1])))
