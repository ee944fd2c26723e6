"""The commands for many runs: ``ailsrs sweep`` and ``ailsrs merge``."""

import contextlib
import dataclasses
import os
import signal
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

from rich.console import Console
from rich.markup import escape
from tyro.conf import Positional, arg

from ailsrs_jax.cli.arguments import Count, Flag, Json, OptionalPath, Quiet, TrackerName
from ailsrs_jax.cli.console import make_console, print_json, this_command
from ailsrs_jax.errors import UserError

LONGEST_SHARD = 20  # characters


def sweep(
    spec: Positional[Path],
    output: OptionalPath = None,
    shard: Annotated[str, arg(metavar="I/N")] = "0/1",
    max_parallel: Count = None,
    launcher: Annotated[str, arg(metavar="local|ray")] = "local",
    track: TrackerName = None,
    dry_run: Flag = False,
    quiet: Quiet = False,
    as_json: Json = False,
) -> None:
    """Train every cell of a declarative grid: algorithms, tasks, demonstrations, settings, seeds.

    The same command goes on where it was stopped.

    Example: ailsrs sweep experiments/smoke.toml --dry-run

    Example: ailsrs sweep paper.toml --output /shared/paper --shard 0/4

    Args:
        spec: A TOML file; docs/sweeps.md says what it holds.
        output: The directory of the sweep; by default runs/NAME, of a file NAME.toml.
        shard: Train only the I-th of N parts, I from 0, of a sweep on several machines.
        max_parallel: With MJX, train at most so many cells at the same time, as one program; by
            default 64.
        launcher: On this machine, or on the Ray cluster that RAY_ADDRESS names.
        track: Send the metrics of each cell to Weights & Biases or Trackio, too, an extra of the
            same name.
        dry_run: Only say what would run, and what it costs at most.
    """
    from ailsrs_jax.cli.progress import SweepProgress, print_estimate
    from ailsrs_jax.cli.signals import StopSignals
    from ailsrs_jax.runs.storage.trackers import require_tracker
    from ailsrs_jax.sweeps import sweep as sweeps
    from ailsrs_jax.sweeps.estimate import estimate
    from ailsrs_jax.sweeps.spec import expand, read_spec

    sweeps.require_launcher(launcher)
    require_tracker(track)
    console = make_console(quiet=quiet, as_json=as_json)
    grid = expand(read_spec(spec))
    output = output or Path("runs") / spec.stem
    max_parallel = sweeps.MAX_PARALLEL if max_parallel is None else max_parallel
    units = sweeps.choose_units(grid, parse_shard(shard), max_parallel)
    pending = sweeps.pending(units, output)
    if dry_run:
        if os.path.lexists(output / sweeps.SWEEP_FILE):
            grid.require_same(output / sweeps.SWEEP_FILE)
            sweeps.require_same_stacks(pending, output)
        estimates = estimate(pending)
        print_estimate(console, estimates)
        if as_json:
            print_json({"to_train": [dataclasses.asdict(each) for each in estimates]})
        return
    grid.save(output / sweeps.SWEEP_FILE)
    console.print(
        f"[bold]{escape(str(spec))}[/] · {len(grid.cells)} cells · {escape(str(output))}",
        soft_wrap=True,
    )
    stop = StopSignals()
    listening = stop if launcher == "local" else contextlib.nullcontext()
    try:
        with listening, SweepProgress(console, units, output) as watch:
            rows = sweeps.run_units(grid, pending, output, launcher, track, watch, stop)
    except KeyboardInterrupt:
        print(f"saved; go on with:\n{this_command()}", file=sys.stderr)
        sys.exit(128 + (stop.received or signal.SIGINT))
    report(console, rows, output, as_json=as_json)


def merge(
    output: Positional[Path],
    sources: Positional[tuple[Path, ...]],
    quiet: Quiet = False,
    as_json: Json = False,
) -> None:
    """Put the directories of a sweep's shards together.

    Example: ailsrs merge runs/paper shards/0 shards/1

    Args:
        output: The directory to write, as the whole sweep on one machine would have left it.
        sources: The directories of the shards.
    """
    from ailsrs_jax.sweeps.merge import merge_sweeps

    console = make_console(quiet=quiet, as_json=as_json)
    report(console, merge_sweeps(output, sources), output, as_json=as_json)


def report(
    console: Console, rows: Sequence[Mapping[str, Any]], output: Path, *, as_json: bool
) -> None:
    """Write table and figures, and say what has failed: then the exit code is 1."""
    from ailsrs_jax.show.sweep_report import report_sweep
    from ailsrs_jax.sweeps.results import DONE, NOT_RUN

    report_sweep(output)
    if as_json:
        print_json({"output": str(output), "cells": rows})
    done = sum(row["status"] == DONE for row in rows)
    failed = [row for row in rows if row["status"] not in (DONE, NOT_RUN)]
    errors = Console(stderr=True, soft_wrap=True)  # --quiet leaves them
    for row in failed:
        errors.print(f"{row['cell']} {row['status']}", style="red", markup=False, highlight=False)
    console.print(
        f"{done} of {len(rows)} cells done; table.md, figures/ and results.csv are in "
        f"{escape(str(output))}",
        soft_wrap=True,
    )
    if failed:
        errors.print(f"{len(failed)} of {len(rows)} failed; the same command tries them again")
        sys.exit(1)


def parse_shard(text: str) -> tuple[int, int]:
    """``I/N`` as two numbers.

    Raises:
        UserError: it is not.
    """
    index, slash, count = text.partition("/")
    if not (slash and index.isdecimal() and count.isdecimal() and len(text) < LONGEST_SHARD):
        raise UserError(f"--shard {text}: write I/N, for example 0/4")
    return int(index), int(count)
