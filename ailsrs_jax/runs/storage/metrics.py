"""The report of an iteration, and the tables that a run appends it to."""

import csv
import dataclasses
import io
import os
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ailsrs_jax.errors import UserError, os_errors, refusing
from ailsrs_jax.files import require_file, write_atomically


@dataclasses.dataclass(frozen=True)
class IterationReport:
    """One iteration of all seeds, as ``watch`` receives it."""

    iteration: int  # counted from 0
    num_iterations: int
    metrics: Mapping[str, np.ndarray]  # (seeds,) each; env_steps since the start of the run
    seconds: float  # that this iteration took
    env_steps_per_second: float  # of all seeds together, in this iteration
    compile_seconds: float | None  # spent before the first iteration, if known
    finished: bool = False  # the run ends here, whatever num_iterations says

    @property
    def is_last(self) -> bool:
        """Whether this is the last iteration of the run."""
        return self.finished or self.iteration + 1 == self.num_iterations

    @property
    def divergence(self) -> UserError | None:
        """The error if most episodes of this iteration diverged, over all seeds; else None."""
        episodes, diverged = (int(self.metrics[name].sum()) for name in ("episodes", "diverged"))
        return _divergence(self.iteration, episodes, diverged)


def share_of(expert_return: float, share: float) -> float:
    """Return the threshold of a ``share`` of an expert's return, which may be negative."""
    return expert_return - (1.0 - share) * abs(expert_return)


class CsvFile:
    """A table that a run appends to, such as ``metrics.csv``."""

    def __init__(self, path: Path, keys: Sequence[Sequence[int]]) -> None:
        """Keep the rows that begin with ``keys``, and drop those that a killed process added.

        ``keys`` are the first columns of each row that has to be there, in order.

        Raises:
            UserError: a row is missing or damaged, or the file cannot be written.
        """
        self._path = path
        kept: list[list[str]] = []  # header and rows
        if keys:
            # A loss of power may have cut off the rows after these, but not these.
            kept = read_rows(path)[: 1 + len(keys)]
            expected = [[str(key) for key in row] for row in keys]
            found = [row[: len(keys[0])] for row in kept[1:]]
            if found != expected or len({len(row) for row in kept}) > 1:
                raise UserError(
                    f"{path} lacks rows of the {keys[-1][0] + 1} iterations done: restore the "
                    f"file, or delete {path.parent / 'checkpoints'} to start over"
                )
        self._has_header = bool(kept)
        write_atomically(path, as_csv(kept))

    def append(
        self, columns: Sequence[str], rows: Sequence[Sequence[Any]], *, to_disk: bool = False
    ) -> None:
        """Append ``rows``; with ``to_disk``, wait until they would survive a loss of power.

        Raises:
            UserError: they cannot be written.
        """
        # Python and NumPy print the shortest digits that read back as the same number.
        lines = [[str(value) for value in row] for row in rows]
        if not self._has_header:
            lines.insert(0, list(columns))
            self._has_header = True
        with os_errors(f"cannot write {self._path}"), self._path.open("ab") as file:
            file.write(as_csv(lines))
            if to_disk:
                file.flush()
                os.fsync(file.fileno())


def read_rows(path: Path) -> list[list[str]]:
    """Read the rows of a CSV file, header first.

    Raises:
        UserError: it cannot be read, or is empty.
    """
    require_file(path)
    with refusing(f"cannot read {path}"), path.open(newline="") as file:
        rows = list(csv.reader(file))  # str.splitlines would split inside of quotes
    if not rows:
        raise UserError(f"{path} is empty")
    return rows


def read_metrics(path: Path) -> dict[str, np.ndarray]:
    """Read the columns of a table of numbers, such as ``metrics.csv``, in float64.

    Raises:
        UserError: it cannot be read, or holds something else than numbers.
    """
    header, *rows = read_rows(path)
    try:
        table = np.array(rows, float).reshape(len(rows), len(header))
    except ValueError as error:  # ragged rows, or text
        raise UserError(f"{path} is not a table of numbers under a header") from error
    return dict(zip(header, table.T, strict=True))


def earlier_divergence(path: Path) -> UserError | None:
    """Return the error of an iteration before this process resumed a stack."""
    metrics = read_metrics(path)
    iterations = metrics["iteration"].astype(int)
    episodes, diverged = (
        np.bincount(iterations, metrics[name]).astype(int) for name in ("episodes", "diverged")
    )
    errors = map(_divergence, range(len(episodes)), episodes, diverged)
    return next(filter(None, errors), None)


def _divergence(iteration: int, episodes: int, diverged: int) -> UserError | None:
    if 2 * diverged <= episodes:
        return None  # enough is left to learn from
    return UserError(
        f"stopped: {diverged} of {episodes} episodes of iteration {iteration} diverged "
        "(observations, actions or rewards that are not finite, or beyond 1e10): the physics is "
        "unstable under these policies; a smaller timestep or noise_std, or less stiffness or gain "
        "in the model, may help"
    )


def as_csv(rows: Iterable[Sequence[Any]]) -> bytes:
    """Return the content of a CSV file; None becomes an empty field."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(rows)
    return text.getvalue().encode()


def percentage(value: float, expert_return: float | None) -> str:
    """Return a return as per cent of the expert's; nothing if that is unknown or not positive."""
    if expert_return is None or expert_return <= 0.0:
        return ""
    return f"{100 * value / expert_return:.0f} %"
