"""The commands that measure: ``ailsrs evaluate`` and ``ailsrs benchmark``."""

import dataclasses
import sys
from pathlib import Path
from typing import Annotated, Any

from rich.markup import escape
from rich.table import Table
from tyro.conf import Positional, arg

from ailsrs_jax.cli.arguments import EnvName, Flag, Json, Quiet
from ailsrs_jax.cli.console import evaluation_fields, make_console, print_json
from ailsrs_jax.errors import UserError


def evaluate(
    policy: Positional[Path],
    episodes: int = 100,
    physics: Annotated[str, arg(metavar="gymnasium|auto|mjx|mujoco")] = "gymnasium",
    seed: int = 0,
    stochastic: Flag = False,
    quiet: Quiet = False,
    as_json: Json = False,
) -> None:
    """Measure the return of a policy, or of every seed of a run.

    Example: ailsrs evaluate runs/hopper

    Example: ailsrs evaluate runs/hopper/seed_0/policy.npz --episodes 20 --physics mujoco --json

    Args:
        policy: A policy.npz or .safetensors, or the directory of a run or an export.
        episodes: Episodes of each policy, at most 1000 steps long.
        physics: gymnasium is the real environment with the policy in NumPy.
        seed: Of the initial states, from 0.
        stochastic: Draw the actions of a Gaussian policy, instead of taking their mean.
    """
    from ailsrs_jax.data.policies import load_policy, policy_files
    from ailsrs_jax.envs.registry import open_env, require_harmless
    from ailsrs_jax.runs import evaluation

    in_gymnasium = physics == "gymnasium"
    rows: list[dict[str, Any]] = []
    table = Table("policy", "environment", f"return, {episodes} episodes", "length", box=None)
    for path in policy_files(policy):
        loaded = load_policy(path)
        require_harmless(loaded.env_id, str(path))
        result = evaluation.evaluate(loaded, episodes, physics, seed, stochastic=stochastic)
        rows.append(
            {
                "policy": str(path),
                "env_id": loaded.env_id,
                "physics": physics if in_gymnasium else open_env(loaded.env_id, physics).engine,
                **evaluation_fields(result),
            }
        )
        length = f"{result.lengths.mean():.0f}"
        table.add_row(escape(str(path)), loaded.env_id, str(result), length)
    if as_json:
        print_json({"policies": rows})
    else:
        make_console(quiet=quiet, as_json=as_json).print(table)


def benchmark(
    envs: Positional[tuple[EnvName, ...]] = ("halfcheetah",),
    physics: Annotated[tuple[str, ...], arg(metavar="mjx|mujoco ...")] = ("mjx", "mujoco"),
    num_directions: int = 320,
    episode_length: int = 1000,
    repeats: int = 3,
    quiet: Quiet = False,
    as_json: Json = False,
) -> None:
    """Measure bare physics, rollouts, training steps and the peers that are installed.

    Example: ailsrs benchmark halfcheetah

    Example: ailsrs benchmark hopper walker2d --physics mujoco --num-directions 32 --json

    Args:
        envs: The tasks.
        physics: The engines.
        num_directions: Directions; twice as many policies are simulated.
        episode_length: Environment steps of an episode.
        repeats: Turns that the stages take; the median counts.
    """
    from ailsrs_jax.cli.progress import print_benchmark
    from ailsrs_jax.envs.physics import choose_engine
    from ailsrs_jax.envs.registry import resolve_env_id
    from ailsrs_jax.runs.benchmark.speed import Row, benchmark

    if min(num_directions, episode_length, repeats) < 1:
        raise UserError("directions, episode length and repeats start at 1")
    env_ids = [resolve_env_id(env) for env in envs]
    engines = [choose_engine(engine)[0] for engine in physics]
    rows: list[Row] = []
    ratios: dict[str, float] = {}
    console = make_console(quiet=quiet, as_json=as_json)
    with console.status("measuring") as status:
        for done in benchmark(env_ids, engines, num_directions, episode_length, repeats):
            rows += done.rows
            ratios |= done.ratios
            status.update(f"{len(rows)} measured")
            if done.problem:
                print(f"ailsrs: {done.problem}", file=sys.stderr)
    if as_json:
        print_json({"rows": [dataclasses.asdict(row) for row in rows], "ratios": ratios})
    else:
        print_benchmark(console, rows, ratios)
