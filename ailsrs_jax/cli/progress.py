"""What a person sees of a run: a live line, or a plain one now and then in a log; and tables."""

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import (
    BarColumn,
    Progress,
    TaskID,
    TextColumn,
    TimeRemainingColumn,
)
from rich.table import Table

from ailsrs_jax.cli.console import evaluation_fields
from ailsrs_jax.runs.benchmark.speed import Row
from ailsrs_jax.runs.evaluation import Evaluation, evaluate
from ailsrs_jax.runs.loop import Result
from ailsrs_jax.runs.storage.metrics import IterationReport
from ailsrs_jax.sweeps.cells import Cell
from ailsrs_jax.sweeps.estimate import CostEstimate, estimated_env_steps
from ailsrs_jax.sweeps.results import DONE
from ailsrs_jax.sweeps.sweep import Unit, is_done
from ailsrs_jax.sweeps.tables import TableRow

LINES_IN_A_LOG = 20  # where there is no terminal to redraw


class RunProgress:
    """Shows iteration reports; a context manager, and the ``watch`` of a run."""

    def __init__(self, console: Console) -> None:
        self._console = console
        self._live = console.is_terminal
        self._progress = Progress(
            # Where a terminal is narrow, the bar and the time give way to the text.
            BarColumn(bar_width=16),
            TextColumn("{task.completed:.0f}/{task.total:.0f}  {task.description}"),
            TimeRemainingColumn(),
            console=console,
            disable=not self._live,
        )
        self._task: TaskID | None = None
        self._begun = False

    def __enter__(self) -> "RunProgress":
        self._progress.start()
        return self

    def __exit__(self, *exception: object) -> None:
        self._progress.stop()

    def __call__(self, report: IterationReport) -> None:
        """Show one iteration."""
        done, total = report.iteration + 1, report.num_iterations
        text = describe(report)
        if not self._begun and report.compile_seconds is not None:
            self._console.print(f"compiled in {report.compile_seconds:.1f} s", highlight=False)
        self._begun = True
        if self._live:
            if self._task is None:
                self._task = self._progress.add_task(text, total=total, completed=report.iteration)
            self._progress.update(self._task, completed=done, description=text)
        elif report.is_last or done % max(total // LINES_IN_A_LOG, 1) == 0:
            self._console.print(f"{done}/{total}  {text}", soft_wrap=True, highlight=False)


class SweepProgress:
    """Shows how a sweep goes; a context manager, and the ``watch`` of a sweep.

    A bar for all of it, in which a cell weighs as much as the steps it is estimated to take, and
    one for what is trained; in a log, a line for each cell that ends.
    """

    def __init__(self, console: Console, units: Sequence[Unit], output: Path) -> None:
        """Of the ``units``, of which some may be finished in the directory ``output``."""
        self._console = console
        cells = [cell for unit in units for cell in unit]
        left = [cell for cell in cells if not is_done(output, cell)]
        self._steps = {cell.name: estimated_env_steps(cell) for cell in left}
        self._counts = {"finished": len(cells) - len(left), "failed": 0}
        self._num_cells = len(cells)
        self._before = 0.0  # estimated steps of what has ended
        self._running: Sequence[Cell] = ()
        self._progress = Progress(
            BarColumn(bar_width=16),
            TextColumn("{task.description}"),
            TimeRemainingColumn(),
            console=console,
            disable=not console.is_terminal,
            speed_estimate_period=3600.0,  # cells differ
        )
        self._all = self._progress.add_task(self._summary(), total=sum(self._steps.values()))
        self._current = self._progress.add_task("", visible=False)

    def __enter__(self) -> "SweepProgress":
        self._progress.start()
        return self

    def __exit__(self, *exception: object) -> None:
        self._progress.stop()

    def begin(self, cells: Sequence[Cell]) -> None:
        """These cells are trained from now on, together."""
        self._running = cells
        self._progress.reset(self._current, description=self._name(), visible=True)
        self._progress.update(self._all, description=self._summary())

    def __call__(self, report: IterationReport) -> None:
        """Show one iteration of them."""
        done, total = report.iteration + 1, report.num_iterations
        if len(self._running) > 1:  # their average
            means = {name: values.mean(keepdims=True) for name, values in report.metrics.items()}
            report = dataclasses.replace(report, metrics=means)
        text = f"{self._name()} · {done}/{total} · {describe(report)}"
        self._progress.update(self._current, completed=done, total=total, description=text)
        steps = sum(self._steps[cell.name] for cell in self._running)
        self._progress.update(self._all, completed=self._before + steps * done / total)

    def end(self, row: TableRow) -> None:
        """A cell is finished, or has failed."""
        done = row["status"] == DONE
        self._counts["finished" if done else "failed"] += 1
        self._before += self._steps[row["cell"]]
        self._running = [cell for cell in self._running if cell.name != row["cell"]]
        self._progress.update(self._all, completed=self._before, description=self._summary())
        self._progress.update(self._current, visible=bool(self._running))
        text = (
            f"return {row['return_mean']:.0f} ± {row['return_std']:.0f}" if done else row["status"]
        )
        count = f"{sum(self._counts.values())}/{self._num_cells}"
        self._console.print(
            f"{count}  {row['cell']}  {text}", soft_wrap=True, highlight=False, markup=False
        )

    def _name(self) -> str:
        first, *others = (cell.name for cell in self._running)
        return f"{first} and {len(others)} others" if others else first

    def _summary(self) -> str:
        counts = self._counts | {"running": len(self._running)}
        return f"{self._num_cells} cells: " + ", ".join(f"{n} {what}" for what, n in counts.items())


def describe(report: IterationReport) -> str:
    """One line: evaluation return of each seed, imitation reward, discriminator loss, speed."""
    metrics = report.metrics
    returns = " ".join(f"{value:.0f}" for value in metrics["evaluation_return"])
    text = f"return {returns}"
    if "imitation_reward" in metrics:
        reward = float(np.mean(metrics["imitation_reward"]))
        loss = float(np.mean(metrics["discriminator_loss"]))
        text += f" · reward {reward:.3f} · loss {loss:.3f}"
    if "validation_loss" in metrics:
        text += f" · validation loss {float(np.mean(metrics['validation_loss'])):.4f}"
    if diverged := int(np.sum(metrics.get("diverged", 0))):
        text += f" · {diverged} of {int(metrics['episodes'].sum())} episodes diverged"
    steps = float(np.mean(metrics["env_steps"])) / 1e6
    speed = report.env_steps_per_second / 1e3
    return f"{text} · {steps:.2f} M steps · {speed:.1f} k/s"


@dataclasses.dataclass(frozen=True)
class Kept:
    """The policy that a seed has kept, measured."""

    seed: int
    iteration: int
    evaluation: Evaluation
    drawn: Evaluation | None  # with its actions drawn, where they can be


def evaluate_kept(result: Result, physics: str) -> list[Kept]:
    """Measure 100 episodes of each seed's."""
    return [
        Kept(
            seed,
            result.kept_iterations[seed],
            evaluate(policy, physics=physics),
            evaluate(policy, physics=physics, stochastic=True) if policy.is_stochastic else None,
        )
        for seed, policy in result.policies.items()
    ]


def print_results(console: Console, result: Result, measured: Sequence[Kept]) -> None:
    """The table that ends a run: the return of the kept policies beside the expert's."""
    table = Table("seed", "kept at iteration", "return, 100 episodes", box=None)
    for kept in measured:
        returns = str(kept.evaluation)
        if kept.drawn is not None:
            returns += f" (actions drawn: {kept.drawn})"
        table.add_row(str(kept.seed), str(kept.iteration), returns)
    expert = result.expert_returns
    if expert is not None:
        table.add_row("expert", "", f"{expert.mean():.0f} ± {expert.std():.0f}", style="dim")
    console.print(table)


def results_fields(result: Result, measured: Sequence[Kept], output: Path) -> dict[str, Any]:
    """The same for ``--json``."""
    config, expert = result.config, result.expert_returns
    return {
        "output": str(output),
        "env_id": config.env_id,
        "physics": config.physics,
        "algorithm": config.algorithm,
        "seeds": [
            {
                "seed": kept.seed,
                "kept_iteration": kept.iteration,
                "policy": str(output / f"seed_{kept.seed}" / "policy.npz"),
                **evaluation_fields(kept.evaluation),
                "drawn": None if kept.drawn is None else evaluation_fields(kept.drawn),
            }
            for kept in measured
        ],
        "expert_return_mean": None if expert is None else float(expert.mean()),
        "expert_return_std": None if expert is None else float(expert.std()),
    }


def print_benchmark(console: Console, rows: Sequence[Row], ratios: Mapping[str, float]) -> None:
    """The tables of ``ailsrs benchmark``, one for each task, and that of the ratios."""
    columns = ("physics", "stage", "steps/s", "compiled in", "memory", "utilization")
    for env_id in dict.fromkeys(row.env for row in rows):
        table = Table(*columns, box=None, title=env_id, title_justify="left")
        for row in rows:
            if row.env == env_id:
                table.add_row(
                    row.physics,
                    row.stage,
                    f"{row.env_steps_per_s:,.0f}",
                    "" if row.compile_s is None else f"{row.compile_s:.1f} s",
                    f"{row.peak_memory_mb:,.0f} MB",
                    "" if row.utilization is None else f"{row.utilization:.2f}",
                )
        console.print(table)
    table = Table("ratio of speeds", "", box=None)
    for name, ratio in ratios.items():
        table.add_row(name, f"{ratio:.2f}")
    console.print(table)


def print_estimate(console: Console, estimates: Sequence[CostEstimate]) -> None:
    """The table of ``ailsrs sweep --dry-run``."""
    columns = ("algorithm", "environment", "physics", "cells", "programs", "steps, at most")
    table = Table(*columns, "memory", "physics alone", box=None)
    for row in estimates:
        table.add_row(
            row.algorithm,
            row.env_id,
            row.engine,
            str(row.num_cells),
            str(row.num_programs),
            f"{row.env_steps / 1e6:,.1f} M",
            f"{row.memory_bytes / 2**20:,.0f} MB",
            "" if row.seconds is None else f"{row.seconds / 60:,.0f} min",
        )
    console.print(table)
    steps = sum(row.env_steps for row in estimates) / 1e6
    text = (
        f"to train: {sum(row.num_cells for row in estimates)} cells in "
        f"{sum(row.num_programs for row in estimates)} programs, at most {steps:,.1f} M steps"
    )
    seconds = [row.seconds for row in estimates if row.seconds is not None]
    if seconds:
        text += f", {sum(seconds) / 3600:,.1f} h for their physics alone on this machine"
    console.print(text, soft_wrap=True, highlight=False)
