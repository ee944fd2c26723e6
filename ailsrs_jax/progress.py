"""What a person sees of a run: a live line, or a plain one now and then in a log; and tables."""

from collections.abc import Mapping, Sequence

import numpy as np
from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TaskID,
    TextColumn,
    TimeRemainingColumn,
)
from rich.table import Table

from ailsrs_jax.runs.benchmark import Row
from ailsrs_jax.runs.evaluation import evaluate
from ailsrs_jax.runs.run import Result
from ailsrs_jax.runs.tracking import IterationReport

LINES_IN_A_LOG = 20  # where there is no terminal to redraw


class RunProgress:
    """Shows iteration reports; a context manager, and the ``watch`` of a run."""

    def __init__(self, console: Console) -> None:
        self._console = console
        self._live = console.is_terminal
        self._progress = Progress(
            MofNCompleteColumn(),
            BarColumn(bar_width=16),
            TextColumn("{task.description}"),
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


def print_results(console: Console, result: Result, physics: str) -> None:
    """The table that ends a run: the return of the kept policies beside the expert's."""
    table = Table("seed", "kept at iteration", "return, 100 episodes", box=None)
    for seed, policy in result.policies.items():
        returns = str(evaluate(policy, physics=physics))
        if policy.is_stochastic:
            drawn = evaluate(policy, physics=physics, stochastic=True)
            returns += f" (actions drawn: {drawn})"
        table.add_row(str(seed), str(result.kept_iterations[seed]), returns)
    expert = result.expert_returns
    if expert is not None:
        table.add_row("expert", "", f"{expert.mean():.0f} ± {expert.std():.0f}", style="dim")
    console.print(table)


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
