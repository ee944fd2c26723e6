"""TensorBoard's event files: each seed has its own, in the directory of its policy."""

import contextlib
import json
import logging
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from tensorboardX import summary
from tensorboardX.proto.event_pb2 import Event, SessionLog
from tensorboardX.proto.summary_pb2 import Summary
from tensorboardX.record_writer import RecordWriter

from ailsrs_jax.errors import one_line
from ailsrs_jax.runs.storage.config import RunConfig
from ailsrs_jax.runs.storage.metrics import IterationReport

GROUP = "metrics/"  # TensorBoard shows all scalars with this prefix in one section
HPARAM_METRICS = ("evaluation_return", "evaluation_length")

logger = logging.getLogger(__name__)


class EventFiles:
    """Appends the metrics of each iteration to the events of each seed.

    The step of a point is the number of live environment steps, so that algorithms can be compared.
    A run does not depend on its events: if one cannot be written, there is one warning and no more
    events.

    This uses tensorboardX's ``RecordWriter``, because its ``SummaryWriter`` blocks forever once its
    background thread has failed to write.
    """

    def __init__(self, output: Path, config: RunConfig, steps: Sequence[int]) -> None:
        """Begin a new file for each seed in the run directory ``output``.

        ``steps`` are the environment steps done with each seed. TensorBoard forgets all points that
        an earlier process wrote beyond them.
        """
        self._writers: list[RecordWriter] = []
        with self._guarded():
            for seed, done in zip(config.seeds, steps, strict=True):
                about = config.as_json() | {"seed": seed}
                del about["seeds"]
                writer = _new_file(output / f"seed_{seed}")
                self._writers.append(writer)
                for event in _first_events(about, int(done)):
                    _write(writer, event)
                writer.flush()

    def append(self, report: IterationReport, *, to_disk: bool) -> None:
        """Write the metrics of an iteration; with ``to_disk``, they survive a loss of power."""
        with self._guarded():
            for index, writer in enumerate(self._writers):
                values = {name: float(each[index]) for name, each in report.metrics.items()}
                values["env_steps_per_second"] = report.env_steps_per_second
                scalars = [
                    Summary.Value(tag=GROUP + name, simple_value=value)
                    for name, value in values.items()
                ]
                step = int(report.metrics["env_steps"][index])
                _write(writer, Event(step=step, summary=Summary(value=scalars)))
                if to_disk:
                    writer.flush()

    def close(self) -> None:
        """Write what is buffered, and close the files."""
        with self._guarded():
            while self._writers:
                self._writers.pop().close()

    @contextlib.contextmanager
    def _guarded(self) -> Iterator[None]:
        """At the first error of any kind, warn and write no more events."""
        try:
            yield
        except Exception as error:
            for writer in self._writers:
                with contextlib.suppress(Exception):
                    writer.close()
            self._writers = []
            reason = getattr(error, "strerror", None) or one_line(error)
            logger.warning("no more events for TensorBoard: %s", reason)


def _new_file(directory: Path) -> RecordWriter:
    """Open a new event file.

    Files are numbered, because TensorBoard reads them in the order of their names, and dates would
    be out of order after a clock is set back.
    """
    directory.mkdir(parents=True, exist_ok=True)
    suffixes = [path.suffix[1:] for path in directory.glob("events.out.tfevents.*")]
    number = 1 + max((int(suffix) for suffix in suffixes if suffix.isdecimal()), default=0)
    return RecordWriter(str(directory / f"events.out.tfevents.{number:06d}"))


def _first_events(about: dict[str, Any], steps: int) -> list[Event]:
    """Return the version, the start after ``steps`` steps, hyperparameters and configuration."""
    hparams = about | about["settings"]
    del hparams["settings"], hparams["versions"]
    metrics = dict.fromkeys(GROUP + name for name in HPARAM_METRICS)
    experiment, started, _ = summary.hparams(hparams, metrics)
    text = summary.text("config", f"```\n{json.dumps(about, indent=2)}\n```")
    return [
        Event(file_version="brain.Event:2"),
        Event(step=steps + 1, session_log=SessionLog(status=SessionLog.START)),
        *(Event(summary=each) for each in (experiment, started, text)),
    ]


def _write(writer: RecordWriter, event: Event) -> None:
    event.wall_time = time.time()
    writer.write(event.SerializeToString())
