"""The commands for many runs: ``ailsrs sweep`` and ``ailsrs merge``."""

import dataclasses
import itertools
import os
import re
import signal
import sys
from collections.abc import Mapping, Sequence, Set
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from rich.console import Console
from rich.table import Table
from tyro.conf import Positional, UseAppendAction, arg

from ailsrs_jax.cli.arguments import Count, Flag, OptionalPath, TrackerName
from ailsrs_jax.cli.terminal import TERMINAL, Terminal, TerminalOptions, this_command
from ailsrs_jax.errors import UserError
from ailsrs_jax.own_code import allow

if TYPE_CHECKING:
    from ailsrs_jax.sweeps.estimate import CostEstimate


def sweep(
    spec: Positional[Path],
    output: OptionalPath = None,
    shard: Annotated[str, arg(metavar="I/N")] = "0/1",
    max_parallel: Count = None,
    launcher: Annotated[str, arg(metavar="local|ray")] = "local",
    track: TrackerName = None,
    dry_run: Flag = False,
    own: Annotated[
        UseAppendAction[tuple[tuple[str, ...], ...]],
        arg(metavar="NAME ...", help_behavior_hint="(repeatable)"),
    ] = (),
    terminal: TerminalOptions = TERMINAL,
) -> None:
    """Train every cell of a declarative grid: algorithms, tasks, demonstrations, settings, seeds.

    The same command continues a sweep that was stopped.

    Example: ailsrs sweep experiments/smoke.toml --dry-run

    Example: ailsrs sweep paper.toml --output /shared/paper --shard 0/4

    Args:
        spec: A TOML file; docs/sweeps.md describes its format.
        output: The directory of the sweep; by default runs/NAME for a file NAME.toml.
        shard: Train only the I-th of N parts, I from 0, to share a sweep among machines.
        max_parallel: Train at most N cells as one program, with MJX; by default 64.
        launcher: Train on this machine, or on the Ray cluster that RAY_ADDRESS names.
        dry_run: Only print what would run, and what it costs at most.
        own: Your own code that the spec names: environments, algorithms, rewards, losses. It is
            imported only if you repeat its names here.
    """
    from ailsrs_jax.cli.progress import SweepProgress
    from ailsrs_jax.cli.signals import StopSignals, keyboard_interrupts
    from ailsrs_jax.runs.storage.trackers import require_tracker
    from ailsrs_jax.sweeps import sweep as sweeps
    from ailsrs_jax.sweeps.estimate import estimate
    from ailsrs_jax.sweeps.spec import expand, read_spec
    from ailsrs_jax.sweeps.unit import pending

    allow(*itertools.chain(*own))
    if (numbers := re.fullmatch(r"(\d{1,18})/(\d{1,18})", shard)) is None:
        raise UserError(f"--shard {shard}: write I/N, for example 0/4")
    sweeps.require_launcher(launcher)
    require_tracker(track)
    grid = expand(read_spec(spec))
    output = output or Path("runs") / spec.stem
    max_parallel = sweeps.MAX_PARALLEL if max_parallel is None else max_parallel
    units = sweeps.choose_units(grid, (int(numbers[1]), int(numbers[2])), max_parallel)
    left = pending(units, output)
    if dry_run:
        if os.path.lexists(output / sweeps.SWEEP_FILE):
            grid.require_same(output / sweeps.SWEEP_FILE)
            sweeps.require_same_stacks(left, output)
        estimates = estimate(left)
        print_estimate(terminal.console, estimates)
        terminal.json({"to_train": [dataclasses.asdict(each) for each in estimates]})
        return
    grid.save(output / sweeps.SWEEP_FILE)
    terminal.line(f"{spec} · {len(grid.cells)} cells · {output}")
    stop = StopSignals()
    listening = stop if launcher == "local" else keyboard_interrupts()
    try:
        with listening, SweepProgress(terminal.console, units, output) as watch:
            rows = sweeps.run_units(grid, left, output, launcher, track, watch, stop)
    except KeyboardInterrupt:
        print(f"saved; continue with:\n{this_command()}", file=sys.stderr)
        sys.exit(128 + (stop.received or signal.SIGINT))
    mine = {cell.name for unit in units for cell in unit}
    report_rows(terminal, rows, output, mine, "; the same command tries them again")


def merge(
    output: Positional[Path],
    sources: Positional[tuple[Path, ...]],
    terminal: TerminalOptions = TERMINAL,
) -> None:
    """Merge the directories of a sweep's shards.

    Example: ailsrs merge runs/paper shards/0 shards/1

    Args:
        output: The directory to write, as if the whole sweep had run on one machine.
        sources: The directories of the shards.
    """
    from ailsrs_jax.sweeps.merge import merge_sweeps

    rows = merge_sweeps(output, sources)
    report_rows(terminal, rows, output, {row["cell"] for row in rows})


def report_rows(
    terminal: Terminal,
    rows: Sequence[Mapping[str, Any]],
    output: Path,
    mine: Set[str],
    advice: str = "",
) -> None:
    """Write tables and figures, and print which of the cells ``mine`` failed.

    If any did, end with that number, ``advice``, and exit code 1.
    """
    from ailsrs_jax.show.sweep_report import report_sweep
    from ailsrs_jax.sweeps.results import DONE, NOT_RUN

    report_sweep(output)
    terminal.json({"output": str(output), "cells": rows})
    done = sum(row["status"] == DONE for row in rows)
    failed = [row for row in rows if row["cell"] in mine and row["status"] not in (DONE, NOT_RUN)]
    errors = Console(stderr=True, soft_wrap=True, highlight=False)  # --quiet does not silence it
    for row in failed:
        errors.print(f"{row['cell']} {row['status']}", style="red", markup=False)
    terminal.line(
        f"{done} of {len(rows)} cells done; table.md, figures/ and results.csv are in {output}"
    )
    if failed:
        errors.print(f"{len(failed)} of {len(mine)} cells failed{advice}")
        sys.exit(1)


def print_estimate(console: Console, estimates: Sequence["CostEstimate"]) -> None:
    """Print the table of ``--dry-run`` and the totals."""
    columns = ("algorithm", "task", "physics", "cells", "programs", "steps, at most")
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
    console.print(text, soft_wrap=True)
