"""TensorBoard's event files: a directory of them for each seed, beside its policy."""

import json
import logging
import os
import struct
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from tensorboardX import summary
from tensorboardX.proto.event_pb2 import Event, SessionLog
from tensorboardX.proto.summary_pb2 import Summary
from tensorboardX.record_writer import masked_crc32c

from ailsrs_jax.errors import one_line
from ailsrs_jax.runs.storage.config import RunConfig
from ailsrs_jax.runs.storage.metrics import IterationReport

GROUP = "metrics/"  # TensorBoard shows in one section what has the same prefix
HPARAM_METRICS = ("evaluation_return", "evaluation_length")

logger = logging.getLogger(__name__)


class EventFiles:
    """Appends each iteration's metrics to the events of each seed.

    A step is a live environment step, the axis on which algorithms can be compared. When an event
    cannot be written there will be no more, and one warning: the run does not depend on them.
    """

    def __init__(self, output: Path, config: RunConfig, steps: Sequence[int]) -> None:
        """Of the run directory ``output``; seeds are ``steps`` far, and what is beyond is void."""
        self._files: list[_EventFile] = []
        try:
            for seed, done in zip(config.seeds, steps, strict=True):
                about = config.as_json() | {"seed": seed}
                del about["seeds"]
                self._files.append(_EventFile(output / f"seed_{seed}", about, int(done)))
        except Exception as error:
            self._give_up(error)

    def append(self, report: IterationReport, *, to_disk: bool) -> None:
        """Write one iteration; with ``to_disk``, so that no loss of power loses it."""
        try:
            for index, file in enumerate(self._files):
                values = {name: float(each[index]) for name, each in report.metrics.items()}
                step = int(report.metrics["env_steps"][index])
                speed = {"env_steps_per_second": report.env_steps_per_second}
                file.append(step, values | speed, to_disk=to_disk)
        except Exception as error:  # of whatever kind: the numbers are in metrics.csv
            self._give_up(error)

    def close(self) -> None:
        """Every event is in its file already."""

    def _give_up(self, error: Exception) -> None:
        self._files = []
        reason = getattr(error, "strerror", None) or one_line(error)
        logger.warning("no more events for TensorBoard: %s", reason)


class _EventFile:
    """The events of one process; those of earlier ones stay, and TensorBoard reads them first.

    Files are numbered, not dated: clocks go backwards.
    """

    def __init__(self, directory: Path, about: dict[str, Any], steps: int) -> None:
        directory.mkdir(parents=True, exist_ok=True)
        suffixes = [path.suffix[1:] for path in directory.glob("events.out.tfevents.*")]
        numbers = [int(suffix) for suffix in suffixes if suffix.isdecimal()]
        self._path = directory / f"events.out.tfevents.{max(numbers, default=0) + 1:06d}"
        hparams = about | about["settings"]
        del hparams["settings"], hparams["versions"]
        metrics = dict.fromkeys(GROUP + name for name in HPARAM_METRICS)
        experiment, started, _ = summary.hparams(hparams, metrics)
        text = summary.text("config", f"```\n{json.dumps(about, indent=2)}\n```")
        self._write(
            Event(file_version="brain.Event:2"),
            # Makes TensorBoard forget what earlier processes wrote beyond these steps.
            Event(step=steps + 1, session_log=SessionLog(status=SessionLog.START)),
            *(Event(summary=each) for each in (experiment, started, text)),
        )

    def append(self, step: int, values: dict[str, float], *, to_disk: bool) -> None:
        scalars = [
            Summary.Value(tag=GROUP + name, simple_value=value) for name, value in values.items()
        ]
        self._write(Event(step=step, summary=Summary(value=scalars)), to_disk=to_disk)

    def _write(self, *events: Event, to_disk: bool = False) -> None:
        records = []
        for event in events:
            event.wall_time = time.time()
            data = event.SerializeToString()
            size = struct.pack("<Q", len(data))
            sums = [struct.pack("<I", masked_crc32c(each)) for each in (size, data)]
            records += [size, sums[0], data, sums[1]]
        with self._path.open("ab") as file:
            file.write(b"".join(records))
            if to_disk:
                file.flush()
                os.fsync(file.fileno())
