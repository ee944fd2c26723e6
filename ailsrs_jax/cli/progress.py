"""The progress of runs and sweeps: live bars on a terminal, plain lines in a log."""

import dataclasses
from collections import deque
from collections.abc import Sequence
from pathlib import Path
from typing import Self

import numpy as np
from rich.console import Console, Group
from rich.live import Live
from rich.progress import (
    BarColumn,
    Progress,
    SpinnerColumn,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.table import Table

from ailsrs_jax.runs.storage.metrics import IterationReport, percentage
from ailsrs_jax.sweeps.cells import Cell
from ailsrs_jax.sweeps.estimate import estimated_env_steps
from ailsrs_jax.sweeps.results import DONE
from ailsrs_jax.sweeps.tables import TableRow
from ailsrs_jax.sweeps.unit import Unit, is_done

LINES_IN_A_LOG = 20  # lines of a run where there is no terminal
WIDTH_OF_A_COURSE = 30  # iterations
BLOCKS = "▁▂▃▄▅▆▇█"
MEANS = {  # metrics of which the mean over seeds is shown
    "imitation_reward": "reward {:.3f}",
    "discriminator_loss": "loss {:.3f}",
    "validation_loss": "validation loss {:.4f}",
}


class RunProgress:
    """The progress of a run, shown inside a ``with`` statement; it is the ``watch`` of the run.

    On a terminal it is a table with a row for each seed, above a bar; else it is plain lines.
    """

    def __init__(
        self, console: Console, seeds: Sequence[int], expert_return: float | None = None
    ) -> None:
        """Show the returns of ``seeds``, and how many per cent of ``expert_return`` they are."""
        self._console, self._seeds, self._expert = console, seeds, expert_return
        self._returns = deque[np.ndarray](maxlen=WIDTH_OF_A_COURSE)  # (seeds,) of each iteration
        self._bar = Progress(
            SpinnerColumn(),
            TextColumn("{task.description}"),
            BarColumn(bar_width=12),
            TimeElapsedColumn(),
            TextColumn("elapsed,"),
            TimeRemainingColumn(),
            TextColumn("left"),
        )
        self._task = self._bar.add_task("compiling", total=None)
        self._live = Live(self._bar, console=console, transient=True)

    def __enter__(self) -> Self:
        if self._console.is_terminal:
            self._live.start()
        else:
            self._console.print("compiling")
        return self

    def __exit__(self, *exception: object) -> None:
        self._live.stop()

    def __call__(self, report: IterationReport) -> None:
        """Show one iteration."""
        done, total = report.iteration + 1, report.num_iterations
        if not self._returns:
            if report.compile_seconds is not None:
                self._console.print(f"compiled in {report.compile_seconds:.1f} s")
            self._bar.reset(self._task, total=total, completed=report.iteration)
        self._returns.append(report.metrics["evaluation_return"])
        if self._console.is_terminal:
            self._bar.update(self._task, completed=done, description=f"{done}/{total}")
            notes = " · ".join(describe_all(report))
            self._live.update(Group(self._table(report), notes, self._bar))
        elif report.is_last or done % max(total // LINES_IN_A_LOG, 1) == 0:
            text = describe(report, self._expert)
            self._console.print(f"{done}/{total}  {text}", soft_wrap=True)

    def _table(self, report: IterationReport) -> Table:
        courses = np.array(self._returns).T
        distances = report.metrics.get("expert_distance")
        table = Table(box=None, padding=(0, 2, 0, 0))
        for name in ("", "return", "of the expert", "distance to it", "returns so far"):
            table.add_column(name, justify="left" if name == "returns so far" else "right")
        highest = max(courses.max(), self._expert or -np.inf)
        for index, returns in enumerate(courses):
            table.add_row(
                f"seed {self._seeds[index]}",
                f"{returns[-1]:.0f}",
                percentage(returns[-1], self._expert),
                "" if distances is None else f"{distances[index]:.2f}",
                sparkline(returns, min(courses.min(), 0.0), highest),
            )
        if self._expert is not None:
            table.add_row("expert", f"{self._expert:.0f}", "100 %", style="dim")
        return table


class SweepProgress:
    """The progress of a sweep, shown inside a ``with`` statement; it is the ``watch`` of the sweep.

    One bar is for all cells, weighted by their estimated steps, and one for the cells in training.
    A line is printed for each cell that ends.
    """

    def __init__(self, console: Console, units: Sequence[Unit], output: Path) -> None:
        """Count the ``units``, some of which may be finished in the directory ``output``."""
        self._console = console
        self._bars = Progress(
            BarColumn(bar_width=16),  # in a narrow terminal the text has priority
            TextColumn("{task.description}"),
            TimeRemainingColumn(),
            TextColumn("left"),
            console=console,
            disable=not console.is_terminal,
            speed_estimate_period=3600.0,  # speeds of cells vary
        )
        cells = [cell for unit in units for cell in unit]
        left = [cell for cell in cells if not is_done(output, cell)]
        self._steps = {cell.name: estimated_env_steps(cell) for cell in left}
        self._counts = {"finished": len(cells) - len(left), "failed": 0}
        self._num_cells = len(cells)
        self._steps_ended = 0.0  # estimated steps of the cells that have ended
        self._running: Sequence[Cell] = ()
        self._all = self._bars.add_task(self._summary(), total=sum(self._steps.values()))
        self._current = self._bars.add_task("", visible=False)

    def __enter__(self) -> Self:
        self._bars.start()
        return self

    def __exit__(self, *exception: object) -> None:
        self._bars.stop()

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


def sparkline(values: np.ndarray, lowest: float, highest: float) -> str:
    """Draw ``values`` as a row of blocks, from ``lowest`` to ``highest``."""
    shares = np.nan_to_num((values - lowest) / (highest - lowest or 1.0))
    return "".join(BLOCKS[int(level)] for level in np.clip(8 * shares, 0, 7))


def describe(report: IterationReport, expert_return: float | None = None) -> str:
    """Return a line with each seed's evaluation return and what holds for all of them."""
    returns = report.metrics["evaluation_return"]
    parts = ["return " + " ".join(f"{value:.0f}" for value in returns)]
    if shares := " ".join(percentage(value, expert_return) for value in returns).strip():
        parts.append(f"{shares} of the expert")
    return " · ".join(parts + describe_all(report))


def describe_all(report: IterationReport) -> list[str]:
    """Return the means over seeds of the other metrics, and the speed."""
    metrics = report.metrics
    means = {name: text for name, text in MEANS.items() if name in metrics}
    parts = [text.format(float(np.mean(metrics[name]))) for name, text in means.items()]
    if diverged := int(np.sum(metrics.get("diverged", 0))):
        parts.append(f"{diverged} of {int(metrics['episodes'].sum())} episodes diverged")
    parts.append(f"{float(np.mean(metrics['env_steps'])) / 1e6:.2f} M steps")
    parts.append(f"{report.env_steps_per_second / 1e3:.1f} k/s")
    return parts
