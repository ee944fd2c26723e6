"""What a run writes down of each iteration: ``metrics.csv``, and the same for TensorBoard."""

from collections.abc import Sequence
from pathlib import Path

from ailsrs_jax.runs.storage.config import RunConfig
from ailsrs_jax.runs.storage.metrics import IterationReport, MetricsFile
from ailsrs_jax.runs.storage.tensorboard import EventFiles


class Journal:
    """Appends to both."""

    def __init__(
        self, output: Path, config: RunConfig, num_done: int, steps: Sequence[int]
    ) -> None:
        """Go on after ``num_done`` iterations, when seeds were ``steps`` far.

        Raises:
            UserError: ``metrics.csv`` lacks rows, or cannot be written.
        """
        self._metrics = MetricsFile(output / "metrics.csv", config.seeds, num_done)
        self._events = EventFiles(output, config, steps)

    def append(self, report: IterationReport, *, to_disk: bool = False) -> None:
        """Write one iteration; with ``to_disk``, so that no loss of power loses it.

        Raises:
            UserError: ``metrics.csv`` cannot be written.
        """
        self._metrics.append(report, to_disk=to_disk)
        self._events.append(report, to_disk=to_disk)

    def close(self) -> None:
        """Close the event files."""
        self._events.close()
