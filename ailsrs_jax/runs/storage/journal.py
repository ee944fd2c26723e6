"""Everything that a run appends to after an iteration."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ailsrs_jax.runs.storage.config import RunConfig
from ailsrs_jax.runs.storage.metrics import CsvFile, IterationReport, read_metrics
from ailsrs_jax.runs.storage.tensorboard import EventFiles
from ailsrs_jax.runs.storage.tracked import Tracker

SECONDS_COLUMNS = ("iteration", "seconds", "compile_seconds")


class Journal:
    """Appends to ``metrics.csv``, ``seconds.csv``, TensorBoard's event files and a tracker.

    Only the two tables can fail. ``seconds.csv`` is apart because a repeated run gives the same
    ``metrics.csv`` to the last bit. Time for compiling is in the row of the first iteration after
    it, so that the sum over a resumed run is right.
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
            UserError: a table lacks rows, or cannot be written.
        """
        done = range(num_done)
        keys = [(iteration, seed) for iteration in done for seed in config.seeds]
        self._seeds = config.seeds
        self._metrics = CsvFile(directory / "metrics.csv", keys)
        path = directory / "seconds.csv"
        self._seconds = CsvFile(path, [(iteration,) for iteration in done])
        self.seconds = 0.0  # since the start of the run, compilation included
        if num_done > 0:
            self.seconds = float(np.sum([*read_metrics(path).values()][1:]))
        self._has_compiled = False
        self._events = EventFiles(directory, config, steps)
        self._tracker = Tracker(track, directory) if track is not None else None

    def append(self, report: IterationReport, *, to_disk: bool = False) -> None:
        """Append an iteration; with ``to_disk``, wait until it would survive a loss of power.

        Raises:
            UserError: a table cannot be written.
        """
        rows = [
            (report.iteration, seed, *(values[index] for values in report.metrics.values()))
            for index, seed in enumerate(self._seeds)
        ]
        self._metrics.append(("iteration", "seed", *report.metrics), rows, to_disk=to_disk)
        compiling = 0.0 if self._has_compiled else report.compile_seconds or 0.0
        self._has_compiled = True
        times = (report.iteration, report.seconds, compiling)
        self._seconds.append(SECONDS_COLUMNS, [times], to_disk=to_disk)
        self.seconds += report.seconds + compiling
        self._events.append(report, to_disk=to_disk)
        if self._tracker is not None:
            self._tracker.append(report)

    def close(self) -> None:
        """Finish the event files, and wait until the tracker has all rows."""
        self._events.close()
        if self._tracker is not None:
            self._tracker.close()
