"""The command ``ailsrs train``."""

import dataclasses
import shlex
import signal
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from rich.table import Table
from tyro.conf import Positional, UseAppendAction, arg

from ailsrs_jax.cli.arguments import (
    Count,
    EnvName,
    Flag,
    OptionalPath,
    PhysicsName,
    Settings,
    TrackerName,
    assignments,
    maybe,
)
from ailsrs_jax.cli.terminal import (
    TERMINAL,
    Terminal,
    TerminalOptions,
    evaluation_fields,
    this_command,
)
from ailsrs_jax.errors import UserError
from ailsrs_jax.runs.storage.metrics import percentage

if TYPE_CHECKING:
    from ailsrs_jax.envs import Env
    from ailsrs_jax.runs.storage.journal import Result


def train(
    env: Positional[EnvName],
    algorithm: Annotated[
        str, arg(metavar="ailsrs|bc|gail|ars|brs|trpo|MODULE:ATTRIBUTE")
    ] = "ailsrs",
    demonstrations: Annotated[str | None, maybe("SOURCE")] = None,
    num_trajectories: Count = None,
    draw_from: Count = None,
    subsample: Annotated[int, arg(metavar="K")] = 1,
    states_only: Flag = False,
    seeds: Annotated[UseAppendAction[tuple[tuple[int, ...], ...]], maybe("SEED ...")] = (),
    iterations: Count = None,
    preset: Annotated[str, arg(metavar="tuned|paper")] = "tuned",
    settings: Settings = (),
    physics: PhysicsName = "auto",
    rollout_batch_size: Count = None,
    workers: Annotated[str | None, maybe("N|ray:N")] = None,
    worker_timeout: Annotated[float | None, maybe("S")] = None,
    output: OptionalPath = None,
    resume: Flag = False,
    checkpoint_every: Annotated[int | None, maybe("K")] = None,
    track: TrackerName = None,
    distributed: Flag = False,
    terminal: TerminalOptions = TERMINAL,
) -> None:
    """Train a policy to imitate demonstrations, or on the environment's reward.

    Example: ailsrs train hopper --num-trajectories 10 --seeds 0 1 2

    Example: ailsrs train hopper --demonstrations mine.npz --set noise_std=0.02 --output runs/mine

    Args:
        algorithm: ailsrs, bc (behaviour cloning) and gail imitate; ars, brs (augmented and basic
            random search) and trpo learn from the environment's reward; or your own.
        demonstrations: A .npz file, minari:DATASET_ID, or a directory of the imitation library; by
            default the shipped expert of the task. expert:paper is an expert with the return of
            the paper's, and expert:linear a linear one.
        num_trajectories: Use the first N episodes; by default 10 of the shipped expert, else all.
        draw_from: Draw these episodes at random from the first N, with the seed of the run.
        subsample: Train on every K-th step of each episode, from a random step on.
        states_only: Do not use the actions of the demonstrations. Where there are none, they are
            inferred with the simulator.
        seeds: Random seeds, from 0, trained together as one batched program, as in --seeds 0 1 2;
            by default 0.
        iterations: Number of iterations; by default the preset's.
        preset: Settings that work on the task, or those of the algorithm's paper.
        rollout_batch_size: Simulations at a time on each device, in random search; fewer need less
            memory. By default all, or as many as are fastest.
        workers: Processes that run the episodes of gymnasium:ID, by default one for each core; or
            ray:N for N actors on the Ray cluster that there is, else on a local one.
        worker_timeout: Seconds that an episode may take there, by default 600; then it is run again
            in a new process.
        output: The run directory to write; by default runs/ENV-DATE-TIME.
        resume: Continue from the newest checkpoint in the output directory.
        checkpoint_every: Save the whole state every K iterations. The default is every ten, with
            a rest after each: a second, or nine times as long as saving has stopped the training.
        distributed: Share one run among the devices of all processes of a SLURM, Open MPI,
            Kubernetes or Cloud TPU job; start each process with this same command.
    """
    import numpy as np

    from ailsrs_jax.cli.progress import RunProgress
    from ailsrs_jax.cli.signals import StopSignals
    from ailsrs_jax.runs import loop
    from ailsrs_jax.runs.plan import plan
    from ailsrs_jax.runs.spec import RunSpec
    from ailsrs_jax.runs.storage.journal import Result
    from ailsrs_jax.runs.storage.processes import is_first_process, join_processes
    from ailsrs_jax.runs.storage.trackers import require_tracker
    from ailsrs_jax.trainers.algorithms import find_algorithm, preset_settings
    from ailsrs_jax.trainers.parts.settings import parse

    if resume and output is None:
        raise UserError("--resume needs --output, the directory of the run to continue")
    if distributed:
        if output is None:
            raise UserError("--distributed needs --output, a directory that all processes see")
        if not find_algorithm(algorithm).shares_devices:
            raise UserError(f"--distributed: {algorithm} has no directions to share")
        join_processes()
        terminal = dataclasses.replace(terminal, quiet=terminal.quiet or not is_first_process())
    require_tracker(track)
    changes = assignments(settings)
    if iterations is not None:
        if "num_iterations" in changes:
            raise UserError("--iterations is the setting num_iterations: give one of them")
        changes = {"num_iterations": str(iterations)} | changes
    spec = RunSpec(
        env=env,
        demonstrations=demonstrations,
        algorithm=algorithm,
        num_trajectories=num_trajectories,
        draw_from=draw_from,
        subsample=subsample,
        states_only=states_only,
        seeds=[seed for group in seeds for seed in group] or [0],
        preset=preset,
        settings=parse(preset_settings(env, preset, algorithm), changes),
        physics=physics,
        rollout_batch_size=rollout_batch_size,
        workers=workers,
        worker_timeout=worker_timeout,
    )
    with terminal.stage("preparing the demonstrations"):
        planned = plan(spec)
    config = planned.config
    continue_by = [] if resume else ["--resume"]
    if output is None:
        name = env.replace(":", ".").replace("/", ".")  # colons are special to scp
        output = Path("runs") / f"{name}-{time.strftime('%Y%m%d-%H%M%S')}"
        continue_by = ["--output", str(output), "--resume"]
    data, learns_from, expert_return = planned.data, "the environment's reward", None
    if data.source is not None and data.expert_returns is not None:
        expert_return = float(np.mean(data.expert_returns))
        given = data.source.described(data.num_trajectories, data.subsample)
        learns_from = f"{given}, return {expert_return:.0f}"
        if data.time_limit != config.settings.episode_length:
            expert_return = None  # of episodes of another length
        learns_from += "" if data.infer is None else ", actions inferred first"
    terminal.line(
        f"{find_algorithm(algorithm).title} on {config.env_id} · {learns_from} · preset {preset} · "
        f"seeds {' '.join(map(str, config.seeds))}\n"
        f"physics {config.physics} ({planned.physics_reason}) · "
        f"devices: {planned.simulator.num_devices} · {output}"
    )
    stop = StopSignals()
    try:
        showing = RunProgress(terminal.console, config.seeds, expert_return)
        with stop, showing as progress:
            (result,) = loop.execute(
                [planned],
                [output],
                resume=resume,
                checkpoint_every=checkpoint_every,
                track=track,
                watch=progress,
                stop=stop,
            )
    except KeyboardInterrupt:
        if is_first_process():
            print(f"saved; continue with:\n{this_command(*continue_by)}", file=sys.stderr)
        sys.exit(128 + (stop.received or signal.SIGINT))
    assert isinstance(result, Result)  # a single run raises its error
    if is_first_process():
        report_result(result, output, planned.simulator.env, terminal)


def report_result(result: "Result", output: Path, env: "Env", terminal: Terminal) -> None:
    """Evaluate the kept policies in ``env``, print their returns and draw the training curve."""
    from ailsrs_jax.runs.evaluation import evaluate
    from ailsrs_jax.show.curves import plot_training_curve
    from ailsrs_jax.trainers.algorithms import find_algorithm
    from ailsrs_jax.trainers.parts.reference import verdict

    plot_training_curve(output)
    if terminal.quiet and not terminal.as_json:
        return
    config, expert = result.config, result.expert_returns
    length, demonstrated = config.settings.episode_length, result.demonstrated_length
    mean, std = (None, None) if expert is None else (float(expert.mean()), float(expert.std()))
    is_distance = find_algorithm(config.algorithm).kept_by == "expert_distance"
    table = Table("seed", "kept at", "return, 100 episodes", "of the expert", "distance", box=None)
    fields: list[dict[str, Any]] = []
    for seed, policy in result.policies.items():
        with terminal.stage(f"evaluating seed {seed}"):
            evaluation = evaluate(policy, env=env, episode_length=length)
        kept, returns, drawn = result.kept_iterations[seed], str(evaluation), None
        if policy.is_stochastic:
            sampled = evaluate(policy, env=env, episode_length=length, stochastic=True)
            returns, drawn = f"{returns} (actions sampled: {sampled})", evaluation_fields(sampled)
        share = percentage(evaluation.mean, mean if demonstrated == length else None)
        distance = -result.scores[seed]
        table.add_row(
            str(seed), str(kept), returns, share, f"{distance:.2f}" if is_distance else ""
        )
        file = str(output / f"seed_{seed}" / "policy.npz")
        row = {"seed": seed, "kept_iteration": kept, "policy": file}
        if is_distance:
            row |= {"distance": distance, "verdict": verdict(distance)}
        fields.append(row | evaluation_fields(evaluation) | {"drawn": drawn})
    if expert is not None:
        is_other = demonstrated != length
        note = f" in episodes of {demonstrated} steps, not {length}" if is_other else ""
        table.add_row("expert", "", f"{mean:.0f} ± {std:.0f}{note}", style="dim")
    terminal.console.print(table)
    if is_distance:
        verdicts = [f"seed {row['seed']} is {row['verdict']}" for row in fields]
        terminal.line(f"judged by the distance, without a reward: {', '.join(verdicts)}")
    terminal.line(f"policies, metrics and training curve are in {output}\nnext:")
    quoted = shlex.quote(str(output))
    for command in ("report {}", "render {} --output video.mp4", "evaluate {}"):
        terminal.line(f"  ailsrs {command.format(quoted)}")
    terminal.json(
        {
            "output": str(output),
            "env_id": config.env_id,
            "physics": config.physics,
            "algorithm": config.algorithm,
            "episode_length": length,
            "seeds": fields,
            "expert_return_mean": mean,
            "expert_return_std": std,
            "expert_episode_length": demonstrated,
        }
    )
