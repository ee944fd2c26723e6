"""What Brax's trainers share: their arguments, and reports on their progress."""

import contextlib
import time
from collections.abc import Iterator
from typing import Any

import numpy as np
from brax.envs.wrappers import training as wrappers

from ailsrs_jax.envs import Env
from ailsrs_jax.envs.wrappers import EndDiverged
from ailsrs_jax.runs.experts.unit_actions import UnitActions
from ailsrs_jax.runs.storage.metrics import IterationReport


def shared_arguments(env: Env, settings: Any, seed: int) -> dict[str, Any]:
    """Return the arguments that ``train`` of PPO and of the evolution strategy both take."""
    return {
        "environment": UnitActions(EndDiverged(env)),
        "wrap_env_fn": wrappers.wrap,
        "max_devices_per_host": 1,
        "num_timesteps": settings.num_env_steps,
        "num_evals": settings.num_evaluations + 1,  # Brax also evaluates before it trains
        "episode_length": settings.episode_length,
        "learning_rate": settings.learning_rate,
        "normalize_observations": True,
        "seed": seed,
    }


class Progress:
    """Counts and times the parts of a training, one for each evaluation."""

    def __init__(self, num_iterations: int) -> None:
        """Begin to time the first of ``num_iterations`` parts."""
        self.iteration = 0
        self._num_iterations = num_iterations
        self._num_steps = 0
        self._started = time.perf_counter()

    @contextlib.contextmanager
    def report(self, num_steps: int, metrics: dict[str, Any]) -> Iterator[IterationReport]:
        """Report the part that ends after ``num_steps`` steps in all, then begin the next part."""
        metrics = metrics | {"env_steps": num_steps}
        seconds = time.perf_counter() - self._started
        yield IterationReport(
            iteration=self.iteration,
            num_iterations=self._num_iterations,
            metrics={name: np.array([value]) for name, value in metrics.items()},
            seconds=seconds,
            env_steps_per_second=(num_steps - self._num_steps) / seconds,
            compile_seconds=None,  # Brax compiles during the first part
        )
        self.iteration, self._num_steps = self.iteration + 1, num_steps
        self._started = time.perf_counter()
