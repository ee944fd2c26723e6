"""A worker that is a Ray actor, on the Ray cluster that there is or on a local one."""

from collections.abc import Sequence
from typing import IO, Any

import ray

from ailsrs_jax.workers import episode
from ailsrs_jax.workers.worker import Failure, attempt


class _Actor:
    def __init__(self, name: Any) -> None:
        self._name, self._env = name, None

    def answer(self, request: Any) -> Any:
        if request is not None:
            return attempt(episode.run, self._env, request)
        self._env = attempt(episode.make, self._name)
        if isinstance(self._env, Failure):
            return self._env
        return attempt(episode.describe, self._env, self._name)


class RayWorker:
    """Answers one request at a time; see :class:`~ailsrs_jax.workers.process.ProcessWorker`."""

    def __init__(self, name: Any, log: IO[bytes]) -> None:
        """Start the actor; its first answer are the facts about the environment."""
        del log  # Ray has its own
        if not ray.is_initialized():
            ray.init(log_to_driver=False, include_dashboard=False)
        self._actor = ray.remote(num_cpus=1)(_Actor).remote(name)
        self.send(None)

    def send(self, request: Any) -> None:
        """Send a request; a dead worker does not answer."""
        self._pending = self._actor.answer.remote(request)

    def answer(self) -> Any:
        """Wait for the answer; None stands for a worker that has died."""
        try:
            return ray.get(self._pending)
        except ray.exceptions.RayActorError:
            return None

    def kill(self) -> None:
        """End the actor at once."""
        ray.kill(self._actor)

    @staticmethod
    def ready(workers: Sequence["RayWorker"], seconds: float) -> list["RayWorker"]:
        """Wait at most so many ``seconds``, and return the workers that have answered or died."""
        by_pending = {worker._pending: worker for worker in workers}
        done, _ = ray.wait(list(by_pending), timeout=seconds)
        return [by_pending[each] for each in done]
