"""What a run reports while it goes: ``metrics.csv``, one row per iteration and seed."""

import csv
import dataclasses
import io
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from ailsrs_jax.data.files import write_atomically
from ailsrs_jax.errors import UserError


@dataclasses.dataclass(frozen=True)
class IterationReport:
    """One iteration of all seeds, for whoever watches."""

    iteration: int  # counted from 0
    num_iterations: int
    metrics: Mapping[str, np.ndarray]  # (seeds,) each; env_steps since the start of the run
    seconds: float  # that this iteration took
    env_steps_per_second: float  # of all seeds together, in this iteration
    compile_seconds: float | None  # spent before the first iteration, if it is known
    finished: bool = False  # nothing is left to do, whatever the number of iterations

    @property
    def is_last(self) -> bool:
        """Whether no other follows."""
        return self.finished or self.iteration + 1 == self.num_iterations


class MetricsFile:
    """Appends to ``metrics.csv``."""

    def __init__(self, path: Path, seeds: Sequence[int], start: int) -> None:
        """Begin at iteration ``start``, dropping rows that a lost run wrote beyond it."""
        self._path = path
        self._seeds = seeds
        kept: list[list[str]] = []
        if start > 0:
            header, *rows = read_rows(path)
            kept = [
                header,
                *(row for row in rows if len(row) == len(header) and int(row[0]) < start),
            ]
        write_atomically(path, lambda file: file.write(_as_csv(kept)))

    def append(self, report: IterationReport) -> None:
        """Write the rows of one iteration."""
        rows: list[list[str]] = []
        if report.iteration == 0:
            rows.append(["iteration", "seed", *report.metrics])
        for index, seed in enumerate(self._seeds):
            # NumPy prints the shortest digits that give the same float back.
            values = [str(values[index]) for values in report.metrics.values()]
            rows.append([str(report.iteration), str(seed), *values])
        try:
            with self._path.open("ab") as file:
                file.write(_as_csv(rows))
        except OSError as error:
            raise UserError(f"cannot write {self._path}: {error.strerror}") from error


def read_rows(path: Path) -> list[list[str]]:
    """The rows of ``metrics.csv``, header first.

    Raises:
        UserError: it cannot be read, or is empty.
    """
    try:
        rows = list(csv.reader(path.read_text().splitlines()))
    except (OSError, UnicodeDecodeError) as error:
        raise UserError(f"cannot read {path}") from error
    if not rows:
        raise UserError(f"{path} is empty")
    return rows


def _as_csv(rows: list[list[str]]) -> bytes:
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(rows)
    return text.getvalue().encode()
