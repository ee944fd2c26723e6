"""The live line of a run in the terminal, or a plain one now and then in a log."""

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

    def __enter__(self) -> "RunProgress":
        self._progress.start()
        return self

    def __exit__(self, *exception: object) -> None:
        self._progress.stop()

    def __call__(self, report: IterationReport) -> None:
        """Show one iteration."""
        done, total = report.iteration + 1, report.num_iterations
        text = describe(report)
        if self._live:
            if self._task is None:
                self._task = self._progress.add_task(text, total=total, completed=report.iteration)
            self._progress.update(self._task, completed=done, description=text)
        elif done == total or done % max(total // LINES_IN_A_LOG, 1) == 0:
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
    steps = float(np.mean(metrics["env_steps"])) / 1e6
    speed = report.env_steps_per_second / 1e3
    return f"{text} · {steps:.2f} M steps · {speed:.1f} k/s"
