"""The progress of runs and sweeps: live bars on a terminal, plain lines in a log."""

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Self

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeRemainingColumn

from ailsrs_jax.runs.storage.metrics import IterationReport
from ailsrs_jax.sweeps.cells import Cell
from ailsrs_jax.sweeps.estimate import estimated_env_steps
from ailsrs_jax.sweeps.results import DONE
from ailsrs_jax.sweeps.sweep import Unit, is_done
from ailsrs_jax.sweeps.tables import TableRow

LINES_IN_A_LOG = 20  # lines of a run where there is no terminal
MEANS = {  # metrics of which the mean over seeds is shown
    "imitation_reward": "reward {:.3f}",
    "discriminator_loss": "loss {:.3f}",
    "validation_loss": "validation loss {:.4f}",
}


class _Bars:
    """Progress bars on a terminal, shown inside a ``with`` statement."""

    def __init__(self, console: Console, text: str, speed_period: float = 30.0) -> None:
        """Show bars with the ``text``; their speed is measured over ``speed_period`` [s]."""
        self._console = console
        self._bars = Progress(
            BarColumn(bar_width=16),  # in a narrow terminal the text has priority
            TextColumn(text),
            TimeRemainingColumn(),
            console=console,
            disable=not console.is_terminal,
            speed_estimate_period=speed_period,
        )

    def __enter__(self) -> Self:
        self._bars.start()
        return self

    def __exit__(self, *exception: object) -> None:
        self._bars.stop()


class RunProgress(_Bars):
    """The progress of a run; it is the ``watch`` of the run."""

    def __init__(self, console: Console) -> None:
        super().__init__(console, "{task.completed:.0f}/{task.total:.0f}  {task.description}")
        self._task: TaskID | None = None

    def __call__(self, report: IterationReport) -> None:
        """Show one iteration."""
        done, total, text = report.iteration + 1, report.num_iterations, describe(report)
        if self._task is None:
            if report.compile_seconds is not None:
                self._console.print(f"compiled in {report.compile_seconds:.1f} s")
            self._task = self._bars.add_task(text, total=total, completed=report.iteration)
        self._bars.update(self._task, completed=done, description=text)
        if not self._console.is_terminal and (
            report.is_last or done % max(total // LINES_IN_A_LOG, 1) == 0
        ):
            self._console.print(f"{done}/{total}  {text}", soft_wrap=True)


class SweepProgress(_Bars):
    """The progress of a sweep; it is the ``watch`` of the sweep.

    One bar is for all cells, weighted by their estimated steps, and one for the cells in training.
    A line is printed for each cell that ends.
    """

    def __init__(self, console: Console, units: Sequence[Unit], output: Path) -> None:
        """Count the ``units``, some of which may be finished in the directory ``output``."""
        super().__init__(console, "{task.description}", speed_period=3600.0)  # speeds of cells vary
        cells = [cell for unit in units for cell in unit]
        left = [cell for cell in cells if not is_done(output, cell)]
        self._steps = {cell.name: estimated_env_steps(cell) for cell in left}
        self._counts = {"finished": len(cells) - len(left), "failed": 0}
        self._num_cells = len(cells)
        self._steps_ended = 0.0  # estimated steps of the cells that have ended
        self._running: Sequence[Cell] = ()
        self._all = self._bars.add_task(self._summary(), total=sum(self._steps.values()))
        self._current = self._bars.add_task("", visible=False)

    def begin(self, cells: Sequence[Cell]) -> None:
        """Show that these cells are now trained together."""
        self._running = cells
        self._bars.reset(self._current, description=self._name(), visible=True)
        self._bars.update(self._all, description=self._summary())

    def __call__(self, report: IterationReport) -> None:
        """Show one iteration: the mean over the cells in training."""
        done, total = report.iteration + 1, report.num_iterations
        if len(self._running) > 1:
            means = {name: values.mean(keepdims=True) for name, values in report.metrics.items()}
            report = dataclasses.replace(report, metrics=means)
        text = f"{self._name()} · {done}/{total} · {describe(report)}"
        self._bars.update(self._current, completed=done, total=total, description=text)
        steps = sum(self._steps[cell.name] for cell in self._running)
        self._bars.update(self._all, completed=self._steps_ended + steps * done / total)

    def end(self, row: TableRow) -> None:
        """Count a cell that is finished or has failed, and print its line."""
        done, name = row["status"] == DONE, row["cell"]
        self._counts["finished" if done else "failed"] += 1
        self._steps_ended += self._steps[name]
        self._running = [cell for cell in self._running if cell.name != name]
        self._bars.update(self._all, completed=self._steps_ended, description=self._summary())
        self._bars.update(self._current, visible=bool(self._running))
        returns = f"return {row['return_mean']:.0f} ± {row['return_std']:.0f}" if done else ""
        line = f"{sum(self._counts.values())}/{self._num_cells}  {name}  {returns or row['status']}"
        self._console.print(line, soft_wrap=True, highlight=False, markup=False)

    def _name(self) -> str:
        first, *others = (cell.name for cell in self._running)
        return f"{first} and {len(others)} others" if others else first

    def _summary(self) -> str:
        counts = self._counts | {"running": len(self._running)}
        return f"{self._num_cells} cells: " + ", ".join(f"{n} {what}" for what, n in counts.items())


def describe(report: IterationReport) -> str:
    """Return a line with each seed's evaluation return, the means of other metrics, and speed."""
    metrics = report.metrics
    parts = ["return " + " ".join(f"{value:.0f}" for value in metrics["evaluation_return"])]
    means = {name: text for name, text in MEANS.items() if name in metrics}
    parts += [text.format(float(np.mean(metrics[name]))) for name, text in means.items()]
    if diverged := int(np.sum(metrics.get("diverged", 0))):
        parts.append(f"{diverged} of {int(metrics['episodes'].sum())} episodes diverged")
    parts.append(f"{float(np.mean(metrics['env_steps'])) / 1e6:.2f} M steps")
    parts.append(f"{report.env_steps_per_second / 1e3:.1f} k/s")
    return " · ".join(parts)
