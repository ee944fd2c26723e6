"""A worker that is a Ray actor, on the Ray cluster that there is or on a local one."""

import logging
import warnings
from collections.abc import Sequence
from typing import IO, Any

import ray

from ailsrs_jax.errors import refusing
from ailsrs_jax.workers.segment import Environments
from ailsrs_jax.workers.worker import Failure, attempt


class _Actor:
    def __init__(self, name: Any) -> None:
        self._envs = attempt(lambda: Environments(name))

    def answer(self, request: Any) -> Any:
        if isinstance(self._envs, Failure):
            return self._envs
        envs = self._envs
        return envs.facts if request is None else attempt(lambda: envs.answer(request))


class RayWorker:
    """Answers one request at a time; see :class:`~ailsrs_jax.workers.process.ProcessWorker`."""

    def __init__(self, name: Any, log: IO[bytes]) -> None:
        """Start the actor; its first answer holds the facts about the environment."""
        del log  # Ray has its own
        if not ray.is_initialized():
            with warnings.catch_warnings():
                # Ray forks only to start its own programs, which do not use JAX.
                warnings.filterwarnings("ignore", message=".*os.fork")
                with refusing("cannot connect to a Ray cluster"):
                    ray.init(
                        log_to_driver=False, logging_level=logging.ERROR, include_dashboard=False
                    )
        self._actor: Any = ray.remote(num_cpus=1)(_Actor).remote(name)
        self.send(None)

    def send(self, request: Any) -> None:
        """Send a request; a dead worker does not answer."""
        self._pending = self._actor.answer.remote(request)

    def answer(self) -> Any:
        """Wait for the answer; None stands for a worker that has died."""
        try:
            return ray.get(self._pending)
        except ray.exceptions.RayTaskError:
            raise
        except ray.exceptions.RayError:  # also if the answer was lost with its machine
            return None

    def kill(self) -> None:
        """End the actor at once."""
        if ray.is_initialized():  # when Python ends, Ray ends before the pools of workers do
            ray.kill(self._actor)

    @staticmethod
    def ready(workers: Sequence["RayWorker"], seconds: float) -> list["RayWorker"]:
        """Wait at most so many ``seconds``, and return the workers that have answered or died."""
        by_pending = {worker._pending: worker for worker in workers}
        done, _ = ray.wait(list(by_pending), timeout=seconds)
        return [by_pending[each] for each in done]
