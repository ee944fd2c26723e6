"""Everything that a run writes into its directory while it goes, except for checkpoints."""

import dataclasses
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ailsrs_jax.components.policy import Policy
from ailsrs_jax.data.policies import SavedPolicy
from ailsrs_jax.files import write_json
from ailsrs_jax.runs.storage.config import RunConfig
from ailsrs_jax.runs.storage.metrics import CsvFile, IterationReport, read_metrics
from ailsrs_jax.runs.storage.policies import EVALUATED, by_seed
from ailsrs_jax.runs.storage.tensorboard import EventFiles
from ailsrs_jax.runs.storage.trackers import Tracker
from ailsrs_jax.trainers.algorithms import find_algorithm
from ailsrs_jax.trainers.parts.reference import verdict

RESULT_FILE = "result.json"


@dataclasses.dataclass(frozen=True)
class Result:
    """The result of a run; :func:`~ailsrs_jax.runs.run.train` returns it."""

    config: RunConfig
    policies: dict[int, SavedPolicy]  #: the kept policy of each seed
    kept_iterations: dict[int, int]  #: the iteration that each was found in
    scores: dict[int, float]  #: that each was kept for, such as minus its distance to the expert
    expert_returns: np.ndarray | None  #: of the episodes that it could draw, if it imitates
    demonstrated_length: int | None = None  #: the time limit of these [environment steps]


class Journal:
    """Appends iterations to all records of a run, and saves what it has found so far.

    The records are ``metrics.csv``, ``seconds.csv``, TensorBoard's event files and a tracker; only
    the two tables can fail. The times have a table of their own because a repeated run gives the
    same ``metrics.csv`` to the last bit. Compilation counts in the row of the iteration after it.

    All methods raise UserError if a table, a policy or ``result.json`` cannot be written.
    """

    def __init__(
        self,
        directory: Path,
        config: RunConfig,
        num_done: int,
        steps: Sequence[int],
        track: str | None = None,
    ) -> None:
        """Drop all rows after ``num_done`` iterations, when each seed had simulated ``steps``.

        Raises:
            UserError: a table lacks rows.
        """
        done = range(num_done)
        keys = [(iteration, seed) for iteration in done for seed in config.seeds]
        self._directory, self._config = directory, config
        self._metrics = CsvFile(directory / "metrics.csv", keys)
        path = directory / "seconds.csv"
        self._times = CsvFile(path, [(iteration,) for iteration in done])
        self._seconds = 0.0  # since the start of the run, compilation included
        if num_done > 0:
            self._seconds = float(np.sum([*read_metrics(path).values()][1:]))
        self._has_compiled = False
        self._events = EventFiles(directory, config, steps)
        self._tracker = Tracker(track, directory) if track is not None else None

    def append(self, report: IterationReport, *, to_disk: bool = False) -> None:
        """Append an iteration; with ``to_disk``, wait until it would survive a loss of power."""
        rows = [
            (report.iteration, seed, *(values[index] for values in report.metrics.values()))
            for index, seed in enumerate(self._config.seeds)
        ]
        self._metrics.append(("iteration", "seed", *report.metrics), rows, to_disk=to_disk)
        compiling = 0.0 if self._has_compiled else report.compile_seconds or 0.0
        self._has_compiled = True
        columns = "iteration", "seconds", "compile_seconds"
        times = report.iteration, report.seconds, compiling
        self._times.append(columns, [times], to_disk=to_disk)
        self._seconds += report.seconds + compiling
        self._events.append(report, to_disk=to_disk)
        if self._tracker is not None:
            self._tracker.append(report)

    def save_evaluated(self, iteration: int, policies: Policy) -> None:
        """Write the ``policies`` that this iteration has evaluated, with an axis for all seeds."""
        for seed, policy in by_seed(policies, self._config).items():
            policy.save(self._directory / f"seed_{seed}" / EVALUATED / f"{iteration}.npz")

    def save(
        self, result: Result, steps: Sequence[int], *, command: str | None, finished: bool
    ) -> None:
        """Write the kept policies and ``result.json``.

        ``steps`` are the live steps of each seed. ``command`` makes the run again, if there is one.
        """
        expert = None
        if result.expert_returns is not None:
            expert = {
                "mean": float(result.expert_returns.mean()),
                "std": float(result.expert_returns.std()),
                "episode_length": result.demonstrated_length,
            }
        is_distance = find_algorithm(self._config.algorithm).kept_by == "expert_distance"
        seeds: dict[int, dict[str, Any]] = {}
        for seed, policy in result.policies.items():
            policy.save(self._directory / f"seed_{seed}" / "policy.npz")
            score = result.scores[seed]
            if math.isfinite(score):  # else no policy has had a score yet
                seeds[seed] = {"kept_iteration": result.kept_iterations[seed], "score": score}
                if is_distance:
                    seeds[seed]["verdict"] = verdict(-score)
        content = {
            "command": command,
            "finished": finished,
            "env_steps": dict(zip(self._config.seeds, np.asarray(steps).tolist(), strict=True)),
            "seconds": self._seconds,
            "expert_return": expert,
            "seeds": seeds,
        }
        write_json(self._directory / RESULT_FILE, content)

    def close(self) -> None:
        """Close the event files, and wait until the tracker has all rows."""
        self._events.close()
        if self._tracker is not None:
            self._tracker.close()
