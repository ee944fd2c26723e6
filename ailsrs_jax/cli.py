"""The command line: ``ailsrs train | evaluate | demonstrate | expert``.

Whatever takes long to import is imported by the command that needs it, so that help and mistakes
answer at once.
"""

import json
import sys
import time
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro
from rich.console import Console
from rich.markup import escape
from rich.table import Table
from tyro.conf import Positional, arg

from ailsrs_jax.errors import UserError

EnvName = Annotated[str, arg(metavar="ENV", help="hopper, walker2d, halfcheetah or swimmer")]
Physics = Literal["auto", "mjx", "mujoco"]
Settings = Annotated[tuple[str, ...], arg(name="set", metavar="NAME=VALUE")]

app = tyro.extras.SubcommandApp()
console = Console()


@app.command
def train(
    env: Positional[EnvName],
    demonstrations: Path | None = None,
    num_trajectories: int = 10,
    seeds: tuple[int, ...] = (0,),
    iterations: int | None = None,
    preset: Literal["tuned", "paper"] = "tuned",
    settings: Settings = (),
    physics: Physics = "auto",
    output: Path | None = None,
    resume: bool = False,
) -> None:
    """Train a linear policy to imitate demonstrations.

    Example: ailsrs train hopper --num-trajectories 10 --seeds 0 1 2

    Args:
        env: The task.
        demonstrations: A demonstration file; without it, the expert that ships with the package.
        num_trajectories: Use the first so many trajectories.
        seeds: Random seeds, trained together as one batched program.
        iterations: How many iterations to run, instead of the preset's.
        preset: Settings found to work on the task, or the paper's Table I.
        settings: Settings to change; a wrong name lists them all.
        physics: mjx is pure JAX, mujoco the C engine; auto takes mjx where there is an accelerator.
        output: The run directory to write; by default runs/ENV-DATE-TIME.
        resume: Go on from the newest checkpoint in the output directory.
    """
    from ailsrs_jax.plotting import plot_training_curve
    from ailsrs_jax.progress import RunProgress
    from ailsrs_jax.runs import run
    from ailsrs_jax.runs.evaluation import evaluate

    assignments = dict(_assignment(text) for text in settings)
    if iterations is not None:
        assignments["num_iterations"] = str(iterations)
    plan = run.make_plan(env, demonstrations, num_trajectories, seeds, preset, physics, assignments)
    config = plan.config
    if resume and output is None:
        raise UserError("--resume needs --output, the directory of the run to go on with")
    output = output or Path("runs") / f"{env}-{time.strftime('%Y%m%d-%H%M%S')}"
    console.print(
        f"[bold]{config.env_id}[/] · {config.num_trajectories} demonstrations "
        f"{escape(config.demonstrations)} · preset {preset} · seeds {_join(seeds)}\n"
        f"physics {config.physics} ({plan.physics_reason}) · {escape(str(output))}",
        highlight=False,
        soft_wrap=True,
    )
    try:
        with RunProgress(console) as progress:
            result = run.execute(plan, output, resume=resume, watch=progress)
    except KeyboardInterrupt:
        console.print(
            f"interrupted; the same command with --output {escape(str(output))} --resume goes on"
        )
        sys.exit(130)

    table = Table("seed", "kept at iteration", "return, 100 episodes", box=None)
    for seed, policy in result.policies.items():
        final = evaluate(policy, physics=config.physics)
        kept = str(result.kept_iterations[seed])
        table.add_row(str(seed), kept, f"{final.mean:.0f} ± {final.std:.0f}")
    table.add_row("expert", "", f"{result.expert_return:.0f}", style="dim")
    console.print(table)
    title = f"AILSRS on {config.env_id} from {config.num_trajectories} demonstrations"
    try:
        plot_training_curve(output, title, result.expert_return, result.kept_iterations)
    except ImportError:
        console.print("no training_curve.png: it needs pip install 'ailsrs_jax[plot]'")
    console.print(f"policies, metrics and training curve are in {escape(str(output))}")


@app.command
def evaluate(
    policy: Positional[Path],
    episodes: int = 100,
    physics: Literal["gymnasium", "auto", "mjx", "mujoco"] = "gymnasium",
    seed: int = 0,
    as_json: Annotated[bool, arg(name="json")] = False,
) -> None:
    """Measure the return of a policy, or of every seed of a run.

    Example: ailsrs evaluate runs/hopper --physics gymnasium

    Args:
        policy: A policy.npz, or a run directory.
        episodes: Episodes of each policy, at most 1000 steps long.
        physics: gymnasium is the real environment with the policy in NumPy.
        seed: Of the initial states.
        as_json: Print JSON.
    """
    from ailsrs_jax.data.policies import load_policy
    from ailsrs_jax.runs import evaluation

    paths = sorted(policy.glob("seed_*/policy.npz")) if policy.is_dir() else [policy]
    if not paths:
        raise UserError(f"{policy} holds no seed_*/policy.npz: is it a finished run?")
    rows: list[dict[str, Any]] = []
    for path in paths:
        loaded = load_policy(path)
        result = evaluation.evaluate(loaded, episodes, physics, seed)
        rows.append(
            {
                "policy": str(path),
                "env_id": loaded.env_id,
                "physics": physics,
                "episodes": episodes,
                "return_mean": result.mean,
                "return_std": result.std,
                "length_mean": float(result.lengths.mean()),
            }
        )
    if as_json:
        print(json.dumps(rows, indent=2))
        return
    table = Table("policy", "environment", f"return, {episodes} episodes", "length", box=None)
    for row in rows:
        returns = f"{row['return_mean']:.0f} ± {row['return_std']:.0f}"
        table.add_row(escape(row["policy"]), row["env_id"], returns, f"{row['length_mean']:.0f}")
    console.print(table)


@app.command
def demonstrate(
    env: Positional[EnvName],
    output: Path,
    num_trajectories: int = 40,
    expert: Path | None = None,
    physics: Physics = "auto",
    seed: int = 0,
) -> None:
    """Roll out an expert and write a demonstration file.

    Example: ailsrs demonstrate hopper --num-trajectories 40 --output hopper.npz

    Args:
        env: The task.
        output: The .npz file to write.
        num_trajectories: Episodes to roll out.
        expert: The expert's policy.npz; without it, the one that ships with the package.
        physics: mjx is pure JAX, mujoco the C engine; auto takes mjx where there is an accelerator.
        seed: Of the initial states.
    """
    from ailsrs_jax.data.demonstrations import save_demonstrations
    from ailsrs_jax.data.policies import expert_path, load_policy
    from ailsrs_jax.envs.registry import resolve_env_id
    from ailsrs_jax.runs import demonstrate

    env_id = resolve_env_id(env)
    policy = load_policy(expert or expert_path(env_id))
    if policy.env_id != env_id:
        raise UserError(f"{expert} is an expert of {policy.env_id}, not of {env_id}")
    demonstrations = demonstrate.demonstrate(policy, num_trajectories, physics=physics, seed=seed)
    save_demonstrations(demonstrations, output)
    returns = demonstrations.returns
    console.print(
        f"{num_trajectories} trajectories of {env_id}, return {returns.mean():.0f} ± "
        f"{returns.std():.0f}, in {escape(str(output))}",
        highlight=False,
    )


@app.command
def expert(
    env: Positional[EnvName],
    output: Path,
    iterations: int | None = None,
    settings: Settings = (),
    physics: Physics = "auto",
    seed: int = 0,
) -> None:
    """Train an expert on the environment's reward, by augmented random search.

    Example: ailsrs expert swimmer --output swimmer_expert.npz

    Args:
        env: The task.
        output: The policy file to write: the best policy met.
        iterations: How many iterations to run, instead of the preset's.
        settings: Settings to change; a wrong name lists them all.
        physics: mjx is pure JAX, mujoco the C engine; auto takes mjx where there is an accelerator.
        seed: Random seed.
    """
    from ailsrs_jax.progress import RunProgress
    from ailsrs_jax.runs.evaluation import evaluate
    from ailsrs_jax.runs.expert import train_expert

    assignments = dict(_assignment(text) for text in settings)
    if iterations is not None:
        assignments["num_iterations"] = str(iterations)
    with RunProgress(console) as progress:
        policy = train_expert(env, seed, physics, assignments, output, watch=progress)
    final = evaluate(policy, physics=physics)
    console.print(
        f"return {final.mean:.0f} ± {final.std:.0f} over 100 episodes, in {escape(str(output))}",
        highlight=False,
    )


def _assignment(text: str) -> tuple[str, str]:
    name, equals, value = text.partition("=")
    if not equals:
        raise UserError(f"--set {text}: write NAME=VALUE")
    return name.replace("-", "_"), value


def _join(values: tuple[int, ...]) -> str:
    return " ".join(map(str, values))


def main() -> None:
    """Run the command line; a user's mistake is one line on standard error and exit code 2."""
    try:
        app.cli(prog="ailsrs", description=__doc__.splitlines()[0])
    except UserError as error:
        print(f"ailsrs: {' '.join(str(error).split())}", file=sys.stderr)
        sys.exit(2)
