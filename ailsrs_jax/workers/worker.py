"""The program of a worker: ``python -m ailsrs_jax.workers.worker FILE_DESCRIPTOR``.

It reads requests from the file descriptor and writes answers to it. It ends when the other side is
closed, also in the middle of an episode, so that it does not outlive the program that started it.
"""

import os
import queue
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


def attempt(function: Callable[..., Any], *arguments: Any) -> Any:
    """Return what ``function`` returns, or a :class:`Failure`."""
    try:
        return function(*arguments)
    except Exception as error:
        return Failure(one_line(error), traceback.format_exc())


def serve(connection: Connection) -> None:
    """Make the environment of the first request, then run the episodes and segments of others."""
    requests: queue.SimpleQueue[Any] = queue.SimpleQueue()
    threading.Thread(target=_receive, args=(connection, requests), daemon=True).start()
    sys.path[:], name = requests.get()
    envs = attempt(Environments, name)
    connection.send(envs if isinstance(envs, Failure) else envs.facts)
    while True:
        connection.send(attempt(envs.answer, requests.get()))


def _receive(connection: Connection, requests: "queue.SimpleQueue[Any]") -> None:
    try:
        while True:
            requests.put(cloudpickle.loads(connection.recv_bytes()))
    finally:
        os._exit(0)


if __name__ == "__main__":
    # A module that is run is another than the one that is imported, and so are its classes.
    from ailsrs_jax.workers import worker

    worker.serve(Connection(int(sys.argv[1])))
