"""The command line: ``ailsrs train | sweep | merge | evaluate | demonstrate | …``.

Whatever takes long to import is imported by the command that needs it, so that help and mistakes
answer at once.
"""

import logging
import os
import signal
import sys
import time
from pathlib import Path
from typing import Annotated

import tyro
from rich.console import Console
from rich.markup import escape
from tyro.conf import Positional, arg

from ailsrs_jax.arguments import AlgorithmName, EnvName, PhysicsName, Seeds, Settings, assignments
from ailsrs_jax.errors import UserError
from ailsrs_jax.export_cli import export
from ailsrs_jax.measure_cli import benchmark, evaluate
from ailsrs_jax.sweep_cli import merge, sweep
from ailsrs_jax.versions import VersionError

app = tyro.extras.SubcommandApp()
console = Console()


@app.command
def train(
    env: Positional[EnvName],
    algorithm: AlgorithmName = "ailsrs",
    demonstrations: Annotated[str | None, arg(metavar="SOURCE")] = None,
    num_trajectories: int | None = None,
    subsample: Annotated[int, arg(metavar="K")] = 1,
    seeds: Seeds = (),
    iterations: int | None = None,
    preset: Annotated[str, arg(metavar="tuned|paper")] = "tuned",
    settings: Settings = (),
    physics: PhysicsName = "auto",
    rollout_batch_size: int | None = None,
    output: Path | None = None,
    resume: bool = False,
    checkpoint_every: Annotated[int, arg(metavar="K")] = 10,
    distributed: bool = False,
) -> None:
    """Train a policy to imitate demonstrations, or on the environment's reward.

    Example: ailsrs train hopper --num-trajectories 10 --seeds 0 1 2

    Args:
        env: The task.
        algorithm: ailsrs, bc (behaviour cloning) and gail imitate; ars, brs (augmented and basic
            random search) and trpo learn from the environment's reward.
        demonstrations: A .npz file, minari:DATASET_ID, or a directory of the imitation library's;
            without it, the expert that ships with the package; expert:paper is one of the paper's
            return.
        num_trajectories: Use the first so many; by default 10 of the shipped expert, else all.
        subsample: Train on every K-th of their steps only, from a random one on.
        seeds: Random seeds, trained together as one batched program; by default 0.
        iterations: How many iterations to run, instead of the preset's.
        preset: Settings found to work on the task, or those of the algorithm's paper.
        settings: Settings to change; a wrong name lists them all.
        physics: mjx is pure JAX, mujoco the C engine; auto takes mjx where there is an accelerator.
        rollout_batch_size: Simulations of a device at a time, for less memory.
        output: The run directory to write; by default runs/ENV-DATE-TIME.
        resume: Go on from the newest checkpoint in the output directory.
        checkpoint_every: Save the whole state every K iterations.
        distributed: One run on the devices of all processes of a SLURM, Open MPI, Kubernetes or
            Cloud TPU job, each of which is started with the same command.
    """
    from ailsrs_jax.plotting import plot_training_curve
    from ailsrs_jax.progress import RunProgress, print_results
    from ailsrs_jax.runs import run
    from ailsrs_jax.runs.algorithms import find_algorithm
    from ailsrs_jax.runs.devices import is_first_process, join_processes
    from ailsrs_jax.signals import StopSignals

    if distributed:
        if output is None:
            raise UserError("--distributed needs --output, a directory that all processes see")
        if not find_algorithm(algorithm).searches:
            raise UserError(f"--distributed: {algorithm} has no directions to share")
        join_processes()
        console.quiet = not is_first_process()

    chosen = [seed for group in seeds for seed in group] or [0]
    plan = run.make_plan(
        env,
        demonstrations,
        num_trajectories,
        chosen,
        preset,
        physics,
        assignments(settings, iterations),
        rollout_batch_size,
        subsample,
        algorithm,
    )
    config = plan.config
    if resume and output is None:
        raise UserError("--resume needs --output, the directory of the run to go on with")
    name = env.replace(":", ".")  # a colon has a meaning in paths of scp, and on Windows
    output = output or Path("runs") / f"{name}-{time.strftime('%Y%m%d-%H%M%S')}"
    learns_from = "the environment's reward"
    if config.num_trajectories:
        learns_from = f"{config.num_trajectories} demonstrations {config.demonstrations}"
    title = f"{plan.algorithm.title} on {config.env_id}"
    console.print(
        f"[bold]{title}[/] · {escape(learns_from)} · preset {preset} · seeds "
        f"{' '.join(map(str, chosen))}\nphysics {config.physics} ({plan.physics_reason}) · "
        f"devices: {plan.devices.count} · {escape(str(output))}",
        highlight=False,
        soft_wrap=True,
    )
    stop = StopSignals()
    try:
        with stop, RunProgress(console) as bar:
            result = run.execute(
                plan, output, resume=resume, checkpoint_every=checkpoint_every, watch=bar, stop=stop
            )
    except KeyboardInterrupt:
        console.print(f"the same command with --output {escape(str(output))} --resume goes on")
        sys.exit(128 + (stop.received or signal.SIGINT))

    print_results(console, result, physics)
    if not is_first_process():
        return
    if config.num_trajectories:
        title += f" from {config.num_trajectories} demonstrations"
    try:
        plot_training_curve(output, title, result)
    except ImportError:
        console.print("no training_curve.png: it needs pip install 'ailsrs_jax[plot]'")
    console.print(f"policies, metrics and training curve are in {escape(str(output))}")


@app.command
def demonstrate(
    env: Positional[EnvName],
    output: Annotated[str, arg(metavar="FILE|minari:DATASET_ID")],
    num_trajectories: int = 40,
    expert: Path | None = None,
    physics: PhysicsName = "auto",
    seed: int = 0,
    action_noise: float = 0.0,
) -> None:
    """Roll out an expert and write demonstrations.

    Example: ailsrs demonstrate hopper --num-trajectories 40 --output hopper.npz

    Args:
        env: The task.
        output: The .npz file to write, or minari:DATASET_ID for a new dataset of Minari's.
        num_trajectories: Episodes to roll out.
        expert: The expert's policy.npz; without it, the one that ships with the package.
        physics: mjx is pure JAX, mujoco the C engine; auto takes mjx where there is an accelerator.
        seed: Of the initial states.
        action_noise: Standard deviation of Gaussian noise added to the expert's actions.
    """
    from ailsrs_jax.data.policies import load_policy
    from ailsrs_jax.data.sources import require_target, save_recording
    from ailsrs_jax.envs.registry import resolve_env_id
    from ailsrs_jax.runs import demonstrate
    from ailsrs_jax.runs.policies import load_expert

    env_id = resolve_env_id(env)
    policy = load_policy(expert) if expert else load_expert(env_id)
    if policy.env_id != env_id:
        raise UserError(f"{expert} is an expert of {policy.env_id}, not of {env_id}")
    require_target(output, env_id)
    recording = demonstrate.record(
        policy, num_trajectories, physics=physics, seed=seed, action_noise=action_noise
    )
    save_recording(recording, output)
    returns = recording.demonstrations.returns
    console.print(
        f"{num_trajectories} trajectories of {env_id}, return {returns.mean():.0f} ± "
        f"{returns.std():.0f}, in {escape(output)}",
        highlight=False,
    )


@app.command
def expert(
    env: Positional[EnvName],
    output: Path,
    algorithm: Annotated[str, arg(metavar="ppo|es|ars")] = "ppo",
    settings: Settings = (),
    physics: PhysicsName = "auto",
    seed: int = 0,
) -> None:
    """Train an expert on the environment's reward.

    Example: ailsrs expert hopper --output hopper_expert.npz

    Args:
        env: The task.
        output: The policy file to write: the best policy met; the last one of es.
        algorithm: Brax's PPO or evolution strategy of a neural policy, or augmented random search
            of a linear one.
        settings: Settings to change; a wrong name lists them all.
        physics: mjx is pure JAX, mujoco the C engine; auto takes mjx where there is an accelerator.
        seed: Random seed.
    """
    from ailsrs_jax.progress import RunProgress
    from ailsrs_jax.runs.evaluation import evaluate
    from ailsrs_jax.runs.expert import search_expert

    changes = assignments(settings)
    with RunProgress(console) as progress:
        policy = search_expert(env, seed, physics, changes, output, progress, algorithm)
    console.print(
        f"return {evaluate(policy, physics=physics)} over 100 episodes, in {escape(str(output))}",
        highlight=False,
    )


for command in (evaluate, sweep, merge, export, benchmark):
    app.command(command)


def main() -> None:
    """Run the command line; a user's mistake is one line on standard error and exit code 2."""
    # XLA, as it takes a program from the cache, prints pages about processor features that only
    # tell the compiler what to prefer.
    os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")
    logging.basicConfig(format="ailsrs: %(message)s")
    try:
        app.cli(prog="ailsrs", description=__doc__.splitlines()[0])
    except KeyboardInterrupt:
        print("ailsrs: interrupted", file=sys.stderr)
        sys.exit(130)
    except (UserError, VersionError) as error:
        print(f"ailsrs: {' '.join(str(error).split())}", file=sys.stderr)
        sys.exit(2)
