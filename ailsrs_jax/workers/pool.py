"""Several workers that share the episodes of a batch."""

import collections
import contextlib
import os
import tempfile
import threading
import time
import weakref
from collections.abc import Sequence
from pathlib import Path
from typing import IO, Any

from ailsrs_jax.errors import UserError
from ailsrs_jax.host_calls import POLL_SECONDS, Interrupted, interrupted
from ailsrs_jax.workers.episode import Facts
from ailsrs_jax.workers.worker import Failure

ATTEMPTS = 3  # at an episode, or at starting a worker


class Pool:
    """Runs episodes; the result depends on neither the number of workers nor their deaths.

    Each worker runs one episode at a time. A worker that dies, or needs more than the allowed time
    for an episode, is replaced, and its episode is run again. Segments of episodes
    (:mod:`~ailsrs_jax.workers.segment`) go to the worker that has run those before.
    """

    def __init__(self, name: Any, label: str, num_workers: int, kind: Any, seconds: float) -> None:
        """Start no worker yet.

        Args:
            name: of the environment; see :func:`~ailsrs_jax.workers.episode.make`.
            label: of the environment, for messages.
            num_workers: how many at most.
            kind: :class:`~ailsrs_jax.workers.process.ProcessWorker`, or a class like it.
            seconds: allowed for an episode, or for starting.
        """
        self._name, self._label, self._kind = name, label, kind
        self._num_workers, self._seconds = num_workers, seconds
        self._facts: Facts | None = None
        self._idle: list[Any] = []
        self._homes: dict[int, Any] = {}  # the worker of each place, modulo the number of workers
        handle, path = tempfile.mkstemp(prefix="ailsrs-", suffix=".log")
        self._path, self._log = Path(path), os.fdopen(handle, "wb")
        self._lock = threading.Lock()  # batches of two threads take turns
        weakref.finalize(self, _finish, self._idle, self._path, self._log)

    def describe(self) -> Facts:
        """Return the facts about the environment, from a first worker.

        Raises:
            UserError: the environment cannot be made.
        """
        if self._facts is None:
            self.run([])
        assert self._facts is not None
        return self._facts

    def run(self, requests: Sequence[Any]) -> list[Any]:
        """Run the episodes or segments, and return them in the same order.

        Raises:
            UserError: the environment has raised an exception, or ended its process repeatedly.
            Interrupted: somebody asked for a stop.
        """
        with self._lock:
            return self._run(requests)

    def _run(self, requests: Sequence[Any]) -> list[Any]:
        episodes: dict[int, Any] = {}
        waiting = collections.deque(range(len(requests)))
        deaths: collections.Counter[int | None] = collections.Counter()
        busy: dict[Any, tuple[int | None, float]] = {}  # with which episode, and until when

        def lose(worker: Any, what: str) -> None:
            index, _ = busy.pop(worker)
            worker.kill()
            self._homes = {place: home for place, home in self._homes.items() if home != worker}
            deaths[index] += 1
            if deaths[index] == ATTEMPTS:
                where = "at its start" if index is None else "in the same episode"
                raise UserError(
                    f"{self._label}: the environment's process has {what} {ATTEMPTS} times "
                    f"{where}; what it printed is in {self._path}"
                )
            if index is not None:
                waiting.appendleft(index)

        try:
            while self._facts is None or len(episodes) < len(requests):
                now = time.monotonic()
                for index in [*waiting]:
                    if (worker := self._choose(requests[index].place)) is not None:
                        waiting.remove(index)
                        worker.send(requests[index])
                        busy[worker] = index, now + self._seconds
                    elif not self._idle:
                        break
                num_starting = sum(index is None for index, _ in busy.values())
                num_needed = max(len(waiting), self._facts is None) - num_starting
                num_missing = self._num_workers - len(busy) - len(self._idle)
                for _ in range(min(num_needed, num_missing)):
                    busy[self._kind(self._name, self._log)] = None, now + self._seconds
                for worker in self._kind.ready(list(busy), POLL_SECONDS):
                    answer = worker.answer()
                    if answer is None:
                        lose(worker, "ended")
                        continue
                    request, _ = busy.pop(worker)
                    self._idle.append(worker)
                    if isinstance(answer, Failure):
                        self._log.write(answer.traceback.encode())
                        self._log.flush()
                        raise UserError(
                            f"{self._label}: {answer.line}; the traceback is in {self._path}"
                        )
                    if request is None:
                        self._facts = answer
                    else:
                        episodes[request] = answer
                for worker, (_, deadline) in [*busy.items()]:
                    if time.monotonic() > deadline:
                        lose(worker, f"not answered within {self._seconds:g} s")
                if interrupted():
                    raise Interrupted
        except BaseException:
            _kill(self._idle)  # an environment that has failed may be in any state
            raise
        finally:
            _kill([*busy])  # they answer a question that nobody asks any more
            if not self._idle:
                self._homes = {}
        return [episodes[index] for index in range(len(requests))]

    def _choose(self, place: int | None) -> Any:
        """Take an idle worker, and the one of this ``place`` for a segment; None if it is busy."""
        if place is None:
            return self._idle.pop() if self._idle else None
        place %= self._num_workers
        homeless = (worker for worker in self._idle if worker not in self._homes.values())
        worker = self._homes.get(place) or next(homeless, None)
        if worker not in self._idle:
            return None
        self._idle.remove(worker)
        self._homes[place] = worker
        return worker


def _kill(workers: list[Any]) -> None:
    while workers:
        workers.pop().kill()


def _finish(workers: list[Any], path: Path, log: IO[bytes]) -> None:
    _kill(workers)
    log.close()
    with contextlib.suppress(OSError):
        if path.stat().st_size == 0:
            path.unlink()
