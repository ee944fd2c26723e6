"""The command line: ``ailsrs train | sweep | merge | evaluate | demonstrate | …``.

Whatever takes long to import is imported by the command that needs it, so that help and mistakes
answer at once.
"""

import importlib.metadata
import logging
import os
import signal
import sys
import time
from pathlib import Path
from typing import Annotated

import tyro
from rich.markup import escape
from tyro.conf import Positional, arg

from ailsrs_jax.cli.arguments import (
    AlgorithmName,
    Count,
    EnvName,
    Flag,
    Json,
    OptionalPath,
    PhysicsName,
    Quiet,
    Seeds,
    Settings,
    Source,
    TrackerName,
    assignments,
)
from ailsrs_jax.cli.console import (
    as_command,
    make_console,
    print_json,
    this_command,
)
from ailsrs_jax.cli.experts import demonstrate, expert
from ailsrs_jax.cli.export import export
from ailsrs_jax.cli.measure import benchmark, evaluate
from ailsrs_jax.cli.show import render, report
from ailsrs_jax.cli.sweep import merge, sweep
from ailsrs_jax.errors import UserError, did_you_mean
from ailsrs_jax.versions import VersionError


def train(
    env: Positional[EnvName],
    algorithm: AlgorithmName = "ailsrs",
    demonstrations: Source = None,
    num_trajectories: Count = None,
    subsample: Annotated[int, arg(metavar="K")] = 1,
    seeds: Seeds = (),
    iterations: Count = None,
    preset: Annotated[str, arg(metavar="tuned|paper")] = "tuned",
    settings: Settings = (),
    physics: PhysicsName = "auto",
    rollout_batch_size: Count = None,
    output: OptionalPath = None,
    resume: Flag = False,
    checkpoint_every: Annotated[int, arg(metavar="K")] = 10,
    track: TrackerName = None,
    distributed: Flag = False,
    quiet: Quiet = False,
    as_json: Json = False,
) -> None:
    """Train a policy to imitate demonstrations, or on the environment's reward.

    Example: ailsrs train hopper --num-trajectories 10 --seeds 0 1 2

    Example: ailsrs train hopper --demonstrations mine.npz --set noise_std=0.02 --output runs/mine

    Args:
        env: The task.
        algorithm: ailsrs, bc (behaviour cloning) and gail imitate; ars, brs (augmented and basic
            random search) and trpo learn from the environment's reward.
        demonstrations: A .npz file, minari:DATASET_ID, or a directory of the imitation library's;
            without it, the expert that ships with the package; expert:paper is one of the paper's
            return.
        num_trajectories: Use the first so many episodes; by default 10 of the shipped expert, else
            all.
        subsample: Train on every K-th of their steps only, from a random one on.
        seeds: Random seeds, from 0, trained together as one batched program; by default 0. As in
            --seeds 0 1 2.
        iterations: How many iterations to run, instead of the preset's.
        preset: Settings found to work on the task, or those of the algorithm's paper.
        settings: Settings to change, as in --set noise_std=0.02 num_directions=64; a wrong name
            lists them all.
        physics: mjx is pure JAX, mujoco the C engine; auto takes mjx where there is an accelerator.
        rollout_batch_size: Simulations of a device at a time, in random search, for less memory;
            by default all, or what is fastest.
        output: The run directory to write; by default runs/ENV-DATE-TIME.
        resume: Go on from the newest checkpoint in the output directory.
        checkpoint_every: Save the whole state every K iterations.
        track: Send the metrics to Weights & Biases or Trackio, too, an extra of the same name.
            TensorBoard's are always written.
        distributed: One run on the devices of all processes of a SLURM, Open MPI, Kubernetes or
            Cloud TPU job, each of which is started with the same command.
    """
    from ailsrs_jax.cli.progress import RunProgress, evaluate_kept, print_results, results_fields
    from ailsrs_jax.cli.signals import StopSignals
    from ailsrs_jax.runs import loop
    from ailsrs_jax.runs.plan import plan
    from ailsrs_jax.runs.spec import RunSpec
    from ailsrs_jax.runs.storage.processes import is_first_process, join_processes
    from ailsrs_jax.runs.storage.trackers import require_tracker
    from ailsrs_jax.trainers.algorithms import find_algorithm, preset_settings
    from ailsrs_jax.trainers.parts.settings import parse

    if distributed:
        if output is None:
            raise UserError("--distributed needs --output, a directory that all processes see")
        if not find_algorithm(algorithm).shares_devices:
            raise UserError(f"--distributed: {algorithm} has no directions to share")
        join_processes()
        quiet = quiet or not is_first_process()
    console = make_console(quiet=quiet, as_json=as_json)
    require_tracker(track)
    chosen = [seed for group in seeds for seed in group] or [0]
    defaults = preset_settings(env, preset, algorithm)
    spec = RunSpec(
        env=env,
        demonstrations=demonstrations,
        algorithm=algorithm,
        num_trajectories=num_trajectories,
        subsample=subsample,
        seeds=chosen,
        preset=preset,
        settings=parse(defaults, assignments(settings, iterations)),
        physics=physics,
        rollout_batch_size=rollout_batch_size,
    )
    planned = plan(spec)
    config = planned.config
    if resume and output is None:
        raise UserError("--resume needs --output, the directory of the run to go on with")
    how_to_resume = [] if resume else ["--resume"]
    if output is None:
        name = env.replace(":", ".")  # a colon has a meaning in paths of scp, and on Windows
        output = Path("runs") / f"{name}-{time.strftime('%Y%m%d-%H%M%S')}"
        how_to_resume = ["--output", str(output), "--resume"]
    learns_from = "the environment's reward"
    if config.num_trajectories:
        learns_from = f"{config.num_trajectories} demonstrations {config.source}"
    title = f"{planned.algorithm.title} on {config.env_id}"
    console.print(
        f"[bold]{title}[/] · {escape(learns_from)} · preset {preset} · seeds "
        f"{' '.join(map(str, chosen))}\nphysics {config.physics} ({planned.physics_reason}) · "
        f"devices: {planned.simulator.num_devices} · {escape(str(output))}",
        soft_wrap=True,
    )
    stop = StopSignals()
    try:
        with stop, RunProgress(console) as bar:
            (result,) = loop.execute(
                [planned],
                [output],
                resume=resume,
                checkpoint_every=checkpoint_every,
                track=track,
                watch=bar,
                stop=stop,
            )
    except KeyboardInterrupt:
        if is_first_process():
            print(f"saved; go on with:\n{this_command(*how_to_resume)}", file=sys.stderr)
        sys.exit(128 + (stop.received or signal.SIGINT))

    assert isinstance(result, loop.Result)  # a single run raises its error
    measured = [] if quiet and not as_json else evaluate_kept(result, physics)
    print_results(console, result, measured)
    if not is_first_process():
        return
    if config.num_trajectories:
        title += f" from {config.num_trajectories} demonstrations"
    try:
        from ailsrs_jax.show.curves import plot_training_curve

        plot_training_curve(output, title, result)
    except ImportError:
        console.print("no training_curve.png: it needs pip install 'ailsrs_jax[plot]'")
    console.print(
        f"policies, metrics and training curve are in {escape(str(output))}", soft_wrap=True
    )
    if as_json:
        print_json(results_fields(result, measured, output))


_FUNCTIONS = (
    *(train, demonstrate, expert, evaluate, export),
    *(render, report, sweep, merge, benchmark),
)
COMMANDS = {function.__name__: as_command(function) for function in _FUNCTIONS}

app = tyro.extras.SubcommandApp()
for each in COMMANDS.values():
    app.command(each)


def main() -> None:
    """Run the command line; a user's mistake is one line on standard error and exit code 2."""
    logging.basicConfig(format="ailsrs: %(message)s")
    if os.environ.get("NO_COLOR"):  # https://no-color.org
        tyro._experimental_options["ansi_codes"] = False
    try:
        require_command(sys.argv[1:])
        # Flags have no opposites: none of them is on without being asked for.
        app.cli(
            prog="ailsrs",
            description=importlib.metadata.metadata("ailsrs_jax")["Summary"],
            config=(tyro.conf.FlagCreatePairsOff, tyro.conf.DisallowNone),
        )
    except KeyboardInterrupt:
        print("ailsrs: interrupted", file=sys.stderr)
        sys.exit(130)
    except BrokenPipeError:  # nobody reads any longer, as after "| head"
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(128 + signal.SIGPIPE)
    except (UserError, VersionError) as error:
        print(f"ailsrs: {' '.join(str(error).split())}", file=sys.stderr)
        sys.exit(2)


def require_command(arguments: list[str]) -> None:
    """Raise UserError if the first of the arguments should be a command, and is none."""
    if arguments and not arguments[0].startswith("-") and arguments[0] not in COMMANDS:
        name = arguments[0]
        raise UserError(
            f"unknown command '{name}'{did_you_mean(name, COMMANDS)}: use one of "
            f"{', '.join(COMMANDS)}; ailsrs --help says more"
        )
