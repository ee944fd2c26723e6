"""The commands ``ailsrs inspect`` and ``ailsrs compare``."""

import dataclasses
import math
import os
import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
from rich.markup import escape
from rich.table import Table
from tyro.conf import Positional, arg

from ailsrs_jax.cli.arguments import Count, OwnEnv, PhysicsName, maybe
from ailsrs_jax.cli.terminal import TERMINAL, Terminal, TerminalOptions
from ailsrs_jax.errors import UserError, os_errors
from ailsrs_jax.own_code import allow
from ailsrs_jax.runs.storage.metrics import percentage

if TYPE_CHECKING:
    from ailsrs_jax.runs.inspection.comparison import RunSummary
    from ailsrs_jax.runs.inspection.demonstrations import Inspection

KEPT = "kept: the return of the kept policies, in % of the expert's"


def inspect(
    demonstrations: Positional[Annotated[str, arg(metavar="FILE|minari:ID|DIR")]],
    task: Positional[Annotated[str | None, maybe("[ENV]")]] = None,
    num_trajectories: Count = None,
    physics: PhysicsName = "auto",
    env: OwnEnv = None,
    terminal: TerminalOptions = TERMINAL,
) -> None:
    """Tell what demonstrations hold, and whether they are of the environment; or how a run went.

    Example: ailsrs inspect mine.npz

    Example: ailsrs inspect runs/hopper

    Example: ailsrs inspect minari:mujoco/hopper/expert-v0 hopper --json

    Args:
        demonstrations: A .npz file, minari:DATASET_ID, or a directory of the imitation library; or
            the directory of a run, which is judged without the environment's reward.
        task: The environment, named as for ailsrs train; by default the one that a .npz file names.
        num_trajectories: Inspect the first N episodes; by default all.
    """
    with os_errors(f"cannot read {demonstrations}"):
        is_run = Path(demonstrations, "config.json").is_file()
    if is_run:
        if (task, num_trajectories, physics, env) != (None, None, "auto", None):
            raise UserError(
                f"{demonstrations} is the directory of a run: it is judged by its records, so "
                "leave the other options out"
            )
        _print_run(Path(demonstrations), terminal)
        return
    from ailsrs_jax.data.demonstrations import load_demonstrations
    from ailsrs_jax.data.sources import open_source
    from ailsrs_jax.envs.registry import open_env, require_harmless, resolve_env_id
    from ailsrs_jax.runs.devices import set_up_jax
    from ailsrs_jax.runs.inspection.demonstrations import inspect_demonstrations
    from ailsrs_jax.runs.training_data import require_fit

    set_up_jax()
    allow(env)
    if task is None:
        if not demonstrations.endswith(".npz"):
            raise UserError(f"name the environment: ailsrs inspect {demonstrations} ENV")
        env_id = load_demonstrations(Path(demonstrations)).env_id
        require_harmless(env_id, demonstrations)
    else:
        env_id = resolve_env_id(task)
    opened = open_env(env_id, physics)
    loaded, _ = open_source(demonstrations, env_id, num_trajectories)
    if num_trajectories is not None:
        loaded = loaded.first(num_trajectories)
    require_fit(loaded, env_id, opened.env)
    with terminal.stage("simulating steps and clones"):
        found = inspect_demonstrations(loaded, opened.env)
    name = shlex.quote(demonstrations)
    command = f"ailsrs train {shlex.quote(task or env_id)} --demonstrations {name}"
    if num_trajectories is not None:
        command += f" --num-trajectories {num_trajectories}"
    if "linear_clone_return" not in found.facts:
        command += " --set policy=linear discriminator_sees=state behavior_cloning_start=false"
    terminal.json({"env_id": env_id, **found.facts, "problems": found.problems, "try": command})
    if not terminal.as_json:
        terminal.console.print(_table(found, env_id))
        for problem in found.problems or ["no problem found"]:
            terminal.line(f"· {problem}")
        terminal.line(f"try: {command}")


def compare(
    directories: Positional[Annotated[tuple[Path, ...], arg(metavar="DIR [DIR ...]")]],
    output: Annotated[Path | None, maybe("FILE.html")] = None,
    terminal: TerminalOptions = TERMINAL,
) -> None:
    """Show runs of one task side by side: returns, distances, and what they cost.

    Returns are those of the evaluation of the kept iteration. The time until 0.9 of the expert
    includes compilation. It is shared by the seeds of a run, and depends on what else the machine
    did.

    Example: ailsrs compare runs/hopper runs/gail

    Example: ailsrs compare runs/hopper runs/gail --output comparison.html

    Args:
        directories: The directories of runs, finished or not.
        output: Also write a page with the table, and with the curves on common axes.
    """
    from ailsrs_jax.cli.progress import sparkline
    from ailsrs_jax.runs.inspection.comparison import compare_runs

    found = compare_runs(directories)
    terminal.json(dataclasses.asdict(found))
    paths = [Path(run.directory).resolve() for run in found.runs]
    shared = os.path.commonpath([path.parent for path in paths])
    header = ("run", "algorithm", "kept", "distance", "0.9 after")
    rows = [
        (
            str(path.relative_to(shared)),
            run.algorithm + (f", {run.num_seeds} seeds" if run.num_seeds > 1 else ""),
            percentage(run.return_mean, run.expert_return) or f"{run.return_mean:.0f}",
            "" if run.distance is None else f"{run.distance:.2f}",
            _cost(run),
        )
        for run, path in zip(found.runs, paths, strict=True)
    ]
    if output is not None:
        from ailsrs_jax.files import require_writable, write_atomically
        from ailsrs_jax.runs.storage.saved_run import read_run
        from ailsrs_jax.show.reports.sweep_page import comparison_page

        require_writable(output)
        saved = {row[0]: read_run(path) for row, path in zip(rows, paths)}
        write_atomically(output, comparison_page(saved, header, rows, f"{KEPT}.").html())
    if terminal.as_json:
        return
    table = Table(box=None, padding=(0, 2, 0, 0))
    for name in header[:2]:
        table.add_column(name, overflow="fold")
    for name in header[2:]:
        table.add_column(name, justify="right", no_wrap=True)
    table.add_column(f"to {found.max_steps / 1e6:.2f} M steps", no_wrap=True)
    courses = [value for run in found.runs for value in run.course]
    highest = max(courses + [run.expert_return or 0.0 for run in found.runs])
    for run, row in zip(found.runs, rows, strict=True):
        course = sparkline(np.array(run.course), min(*courses, 0.0), highest)
        table.add_row(*map(escape, row), course)
    terminal.line(f"{found.env_id} · {KEPT}")
    terminal.console.print(table)
    if output is not None:
        terminal.line(str(output))


def _cost(run: "RunSummary") -> str:
    if run.steps_to_90 is None or run.seconds_to_90 is None:
        return ""
    if math.isinf(run.steps_to_90):
        return "never"
    return f"{run.steps_to_90 / 1e6:.2f} M, {run.seconds_to_90:.0f} s"


def _print_run(directory: Path, terminal: Terminal) -> None:
    from ailsrs_jax.runs.inspection.run import inspect_run
    from ailsrs_jax.runs.storage.saved_run import read_run

    seeds = inspect_run(read_run(directory))
    terminal.json({"seeds": [dataclasses.asdict(seed) for seed in seeds]})
    for seed in [] if terminal.as_json else seeds:
        terminal.line(
            f"seed {seed.seed}: {seed.verdict} at iteration {seed.kept_iteration}, distance "
            f"{seed.distance:.2f}"
        )
        for reason in seed.reasons:
            terminal.line(f"· {reason}")


def _table(found: "Inspection", env_id: str) -> Table:
    facts = found.facts
    table = Table("", "", box=None, show_header=False)

    def row(name: str, text: str) -> None:
        table.add_row(name, escape(text))

    expert = facts["return_mean"]
    every = f", one step in {facts['every']}" if facts["every"] > 1 else ""
    row("demonstrations", f"{facts['episodes']} episode{'s' * (facts['episodes'] > 1)} of {env_id}")
    row("transitions", f"{facts['transitions']}{every}")
    row("length", f"{facts['shortest']} to {facts['longest']} steps")
    row("return", f"{expert:.0f} ± {facts['return_std']:.0f}")
    row("episodes can start at their states", "yes" if facts["sets_states"] else "no")
    if "difference_to_simulation" in facts:
        share = 100 * facts["difference_to_simulation"]
        row("simulated steps differ by", f"{share:.1f} % of what a step changes")
    if "linear_clone_return" not in facts:
        row("actions", "none")
        return table
    if facts["actions_inferred"]:
        row("actions", "none; those that lead from each state to the next are inferred")
    row("actions at their limits", f"{100 * facts['clipped_actions']:.0f} %")
    plain = facts["r_squared_without_intercept"]
    row("R² of a linear policy", f"{facts['r_squared']:.2f}, {plain:.2f} without an intercept")
    for kind in ("linear", "neural"):
        value = facts[f"{kind}_clone_return"]
        share = percentage(value, expert)
        row(f"return of a {kind} clone", f"{value:.0f}" + (f", {share}" if share else ""))
    return table
