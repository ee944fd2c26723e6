"""The progress of runs."""

import weakref

import numpy as np
from rich.console import Console

from ailsrs_jax.cli.progress import WIDTH_OF_A_COURSE, RunProgress
from ailsrs_jax.runs.storage.metrics import IterationReport


def test_a_long_run_keeps_only_the_returns_that_are_shown(tmp_path) -> None:
    shown: list[weakref.ref[np.ndarray]] = []
    with (tmp_path / "log").open("w") as file, RunProgress(Console(file=file), [0]) as progress:
        for iteration in range(10 * WIDTH_OF_A_COURSE):
            returns = np.ones(1)
            shown.append(weakref.ref(returns))
            metrics = {"evaluation_return": returns, "env_steps": np.ones(1)}
            progress(IterationReport(iteration, 1000, metrics, 1.0, 1.0, None))
        del returns, metrics
        assert sum(reference() is not None for reference in shown) == WIDTH_OF_A_COURSE
