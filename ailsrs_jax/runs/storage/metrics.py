"""What a run reports while it goes: ``metrics.csv``, one row per iteration and seed."""

import csv
import dataclasses
import io
import os
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from ailsrs_jax.errors import UserError, one_line
from ailsrs_jax.files import require_file, write_atomically


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

    def require_most_finite(self) -> None:
        """Raise UserError if most of the episodes diverged, of all seeds together."""
        episodes, diverged = (int(self.metrics[name].sum()) for name in ("episodes", "diverged"))
        require_most_finite(self.iteration, episodes, diverged)


def require_most_finite(iteration: int, episodes: int, diverged: int) -> None:
    """Raise UserError if most of the episodes diverged: there is hardly anything to learn."""
    if 2 * diverged > episodes:
        raise UserError(
            f"stopped: {diverged} of {episodes} episodes of iteration {iteration} diverged "
            "(observations, actions or rewards that are not finite, or beyond 1e10): the physics "
            "is unstable under these policies; a smaller timestep or noise_std, or less stiffness "
            "or gain in the model, may help"
        )


class MetricsFile:
    """Appends to ``metrics.csv``."""

    def __init__(self, path: Path, seeds: Sequence[int], start: int) -> None:
        """Begin at iteration ``start``, dropping rows that a lost run wrote beyond it.

        Raises:
            UserError: the rows before it are not all there, or it cannot be written.
        """
        self._path = path
        self._seeds = seeds
        kept: list[list[str]] = []
        if start > 0:
            # Rows beyond may have been cut off in the middle, those before may not.
            kept = read_rows(path)[: 1 + start * len(seeds)]
            expected = [[str(i), str(seed)] for i in range(start) for seed in seeds]
            if [row[:2] for row in kept[1:]] != expected or len({len(row) for row in kept}) > 1:
                raise UserError(
                    f"{path} lacks rows of the {start} iterations done: put it back as it was, or "
                    f"delete {path.parent / 'checkpoints'} to begin anew"
                )
        write_atomically(path, lambda file: file.write(_as_csv(kept)))

    def append(self, report: IterationReport, *, to_disk: bool = False) -> None:
        """Write the rows of one iteration; with ``to_disk``, so that no loss of power loses them.

        Raises:
            UserError: they cannot be written.
        """
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
                if to_disk:
                    file.flush()
                    os.fsync(file.fileno())
        except OSError as error:
            raise UserError(f"cannot write {self._path}: {error.strerror}") from error


def read_rows(path: Path) -> list[list[str]]:
    """The rows of ``metrics.csv``, header first.

    Raises:
        UserError: it cannot be read, or is empty.
    """
    require_file(path)
    try:
        with path.open(newline="") as file:  # a text may hold what splitlines takes for an end
            rows = list(csv.reader(file))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise UserError(f"cannot read {path}: {one_line(error)}") from error
    if not rows:
        raise UserError(f"{path} is empty")
    return rows


def read_metrics(path: Path) -> dict[str, np.ndarray]:
    """The columns of ``metrics.csv`` by name, in float64.

    Raises:
        UserError: it cannot be read, or is no table of numbers.
    """
    header, *rows = read_rows(path)
    try:
        table = np.array(rows, float).reshape(len(rows), len(header))
    except ValueError as error:  # ragged, or words
        raise UserError(f"{path} is not a table of numbers under a header") from error
    return dict(zip(header, table.T, strict=True))


def _as_csv(rows: list[list[str]]) -> bytes:
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(rows)
    return text.getvalue().encode()
