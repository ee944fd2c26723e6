"""A worker that is a process of this machine."""

import contextlib
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Sequence
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import IO, Any

import cloudpickle

# The workers use all cores, so more threads in each would not make them faster.
ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")


class ProcessWorker:
    """Answers one request at a time."""

    def __init__(self, name: Any, log: IO[bytes]) -> None:
        """Start the process; its first answer holds the facts about the environment.

        Args:
            name: of the environment; see :func:`~ailsrs_jax.workers.episode.make`.
            log: receives what the environment prints.
        """
        ours, theirs = socket.socketpair()
        path = filter(None, (str(Path(__file__).parents[2]), os.environ.get("PYTHONPATH")))
        with theirs:
            self._process = subprocess.Popen(
                [sys.executable, "-P", "-m", "ailsrs_jax.workers.worker", str(theirs.fileno())],
                pass_fds=[theirs.fileno()],
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
                start_new_session=True,  # Ctrl-C is for the program that started it
                env={**os.environ, **ONE_THREAD, "PYTHONPATH": os.pathsep.join(path)},
            )
        self._connection = Connection(ours.detach())
        self.send(sys.path)
        self.send(name)

    def send(self, request: Any) -> None:
        """Send a request; a dead worker does not answer."""
        with contextlib.suppress(OSError):
            self._connection.send_bytes(cloudpickle.dumps(request))

    def answer(self) -> Any:
        """Wait for the answer; None stands for a worker that has died."""
        try:
            return self._connection.recv()
        except (EOFError, OSError):
            return None

    def kill(self) -> None:
        """End the process at once, and the processes that the environment has started."""
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self._process.pid, signal.SIGKILL)
        self._process.wait()
        self._connection.close()

    @staticmethod
    def ready(workers: Sequence["ProcessWorker"], seconds: float) -> list["ProcessWorker"]:
        """Wait at most so many ``seconds``, and return the workers that have answered or died."""
        by_connection = {worker._connection: worker for worker in workers}
        return [by_connection[each] for each in wait(list(by_connection), seconds)]  # type: ignore[index]
