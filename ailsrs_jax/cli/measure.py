"""The commands that measure: ``ailsrs evaluate`` and ``ailsrs benchmark``."""

import dataclasses
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from rich.console import Console
from rich.markup import escape
from rich.table import Table
from tyro.conf import Positional, arg

from ailsrs_jax.cli.arguments import Count, Flag, OwnEnv, RealPhysicsName, Seed
from ailsrs_jax.cli.terminal import TERMINAL, TerminalOptions, evaluation_fields
from ailsrs_jax.errors import UserError
from ailsrs_jax.own_code import allow

if TYPE_CHECKING:
    from ailsrs_jax.runs.benchmark.speed import Row


def evaluate(
    policy: Positional[Path],
    episodes: int = 100,
    physics: RealPhysicsName = "gymnasium",
    seed: Seed = 0,
    stochastic: Flag = False,
    episode_length: Count = None,
    env: OwnEnv = None,
    terminal: TerminalOptions = TERMINAL,
) -> None:
    """Measure the return of a policy, or of every seed of a run.

    Example: ailsrs evaluate runs/hopper

    Example: ailsrs evaluate runs/hopper/seed_0/policy.npz --episodes 20 --physics mujoco --json

    Args:
        policy: A policy.npz or .safetensors, or the directory of a run or an export.
        episodes: Episodes of each policy.
        stochastic: Sample the actions of a Gaussian policy instead of taking their mean.
        episode_length: Steps of an episode; by default those of the run that the policy is in, else
            the environment's time limit.
    """
    from ailsrs_jax.data.policies import load_policy, policy_files
    from ailsrs_jax.envs.registry import open_env
    from ailsrs_jax.runs import evaluation
    from ailsrs_jax.runs.horizon import policy_horizon

    allow(env)
    rows: list[dict[str, Any]] = []
    table = Table("policy", "environment", f"return, {episodes} episodes", "length", box=None)
    for path in policy_files(policy):
        loaded = load_policy(path)
        result = evaluation.evaluate(
            loaded,
            episodes,
            physics,
            seed,
            episode_length=policy_horizon(path) if episode_length is None else episode_length,
            stochastic=stochastic,
        )
        engine = physics if physics == "gymnasium" else open_env(loaded.env_id, physics).engine
        row = {"policy": str(path), "env_id": loaded.env_id, "physics": engine}
        rows.append(row | evaluation_fields(result))
        length = f"{result.lengths.mean():.0f}"
        table.add_row(escape(str(path)), loaded.env_id, str(result), length)
    terminal.json({"policies": rows})
    if not terminal.as_json:
        terminal.console.print(table)


def benchmark(
    envs: Positional[Annotated[tuple[str, ...], arg(metavar="[ENV ...]")]] = ("halfcheetah",),
    physics: Annotated[tuple[str, ...], arg(metavar="mjx|mujoco ...")] = ("mjx", "mujoco"),
    num_directions: Count = None,
    episode_length: int = 1000,
    repeats: int = 3,
    terminal: TerminalOptions = TERMINAL,
) -> None:
    """Measure bare physics, episodes, training steps and the installed peers.

    Example: ailsrs benchmark halfcheetah

    Example: ailsrs benchmark hopper walker2d --physics mujoco --num-directions 32 --json

    Args:
        envs: The tasks, named as for ailsrs train.
        physics: The engines.
        num_directions: Directions of the search, by default those of the preset tuned; two policies
            are simulated for each.
        episode_length: Environment steps of an episode.
        repeats: Times that each stage is measured; the median counts.
    """
    from ailsrs_jax.cli.signals import keyboard_interrupts
    from ailsrs_jax.envs.physics import choose_engine
    from ailsrs_jax.envs.registry import resolve_env_id
    from ailsrs_jax.runs.benchmark.speed import benchmark

    if min(1 if num_directions is None else num_directions, episode_length, repeats) < 1:
        raise UserError("directions, episode length and repeats must be at least 1")
    env_ids = [resolve_env_id(env) for env in envs]
    engines = [choose_engine(engine)[0] for engine in physics]
    rows: list[Row] = []
    ratios: dict[str, float] = {}
    with keyboard_interrupts(), terminal.console.status("measuring") as status:
        for done in benchmark(env_ids, engines, num_directions, episode_length, repeats):
            rows += done.rows
            ratios |= done.ratios
            status.update(f"{len(rows)} measured")
            if done.problem:
                print(f"ailsrs: {done.problem}", file=sys.stderr)
    terminal.json({"rows": [dataclasses.asdict(row) for row in rows], "ratios": ratios})
    if not terminal.as_json:
        print_benchmark(terminal.console, rows, ratios)


def print_benchmark(console: Console, rows: Sequence["Row"], ratios: Mapping[str, float]) -> None:
    """Print a table of speeds for each task, and one of their ratios."""
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
