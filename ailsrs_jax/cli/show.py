"""The commands that show or hand on a policy: ``ailsrs render``, ``report`` and ``export``."""

from pathlib import Path
from typing import Annotated, Any

from tyro.conf import Positional, arg

from ailsrs_jax.cli.arguments import (
    Count,
    Flag,
    OptionalPath,
    OwnEnv,
    PhysicsName,
    PolicyPath,
    RealPhysicsName,
    Seed,
    maybe,
)
from ailsrs_jax.cli.terminal import TERMINAL, TerminalOptions, evaluation_fields
from ailsrs_jax.errors import UserError
from ailsrs_jax.own_code import allow


def render(
    policy: PolicyPath,
    output: Annotated[Path, arg(metavar="FILE.mp4|.webp|.html")],
    learning: Flag = False,
    play: Flag = False,
    expert: OptionalPath = None,
    alone: Flag = False,
    physics: PhysicsName = "auto",
    seed: Seed = 0,
    seconds: float = 10.0,
    size: Count = None,
    env: OwnEnv = None,
    terminal: TerminalOptions = TERMINAL,
) -> None:
    """Show one episode of a policy beside the expert's, from the same initial state.

    Example: ailsrs render runs/hopper --output hopper.mp4

    Example: ailsrs render runs/hopper --learning --output learning.mp4

    Example: ailsrs render runs/hopper --play --output play.html

    Args:
        policy: A policy.npz, or a run directory, whose first seed is shown.
        output: A video, an animated picture, or a page with Brax's interactive viewer, which needs
            no renderer.
        learning: Show policies of several iterations of a run instead, from the first to the kept
            one, above the learning curve. A video or an animated picture.
        play: Write a page on which the policies run in the browser instead. You push the robot, and
            change the physics and single weights. npm fetches MuJoCo for it once. The physics is
            always MuJoCo's; --seconds and --size mean nothing.
        expert: The expert's policy.npz; by default the shipped expert of the task, if any.
        alone: Do not show an expert.
        seconds: Show at most this much of the episode, in real time.
        size: Height and width of each picture in pixels, an even number; by default 480, with
            --learning 240.
    """
    if learning and (alone or expert is not None):
        raise UserError("--learning shows no expert: leave out --expert and --alone")
    if learning and play:
        raise UserError("--learning is a film, and --play is a page: leave out one of them")
    if play:
        from ailsrs_jax.show.learning import write_play

        with terminal.stage("writing the page"):
            names = write_play(policy, output, expert=expert, alone=alone, seed=seed)
        terminal.line(str(output))
        terminal.json({"output": str(output), "policies": names})
        return
    with terminal.stage("rendering") as watch:
        from ailsrs_jax.show.learning import film_learning
        from ailsrs_jax.show.video import Animation, render

        allow(env)
        options: dict[str, Any] = {"physics": physics, "seed": seed, "seconds": seconds}
        options |= {"watch": watch} if size is None else {"watch": watch, "size": size}
        animation: Animation
        if learning:
            animation = film_learning(policy, output, **options)
        else:
            animation = render(policy, output, expert=expert, alone=alone, **options)
    episodes: list[dict[str, Any]] = [
        {"label": label, "length": replay.num_steps, "return": float(replay.env_rewards.sum())}
        for label, replay in zip(animation.labels, animation.replays, strict=True)
    ]
    shown = [f"{e['label']} {e['length']} steps, return {e['return']:.0f}" for e in episodes]
    terminal.line(f"{', '.join(shown)}: {output}")
    terminal.json({"output": str(output), "episodes": episodes})


def report(
    directory: Positional[Annotated[Path, arg(metavar="DIR")]],
    output: Annotated[Path | None, maybe("FILE.html")] = None,
    episodes: int = 100,
    no_video: Flag = False,
    env: OwnEnv = None,
    terminal: TerminalOptions = TERMINAL,
) -> None:
    """Write one self-contained HTML page on a run or a sweep.

    It begins with the answer, and shows tables, a video, curves, weights and settings.

    Example: ailsrs report runs/hopper

    Args:
        directory: The directory of a run or a sweep, finished or not.
        output: The page; by default report.html in the directory.
        episodes: Episodes of each policy of a run, to measure its return.
        no_video: Leave out the video of the policies, which takes the most time.
    """
    from ailsrs_jax.show.reports.report import report

    allow(env)
    with terminal.stage("writing the report") as watch:
        path = report(directory, output, episodes=episodes, video=not no_video, watch=watch)
    terminal.line(str(path))
    terminal.json({"output": str(path)})


def export(
    policy: PolicyPath,
    output: Annotated[Path, arg(metavar="FILE|DIRECTORY")],
    episodes: int = 100,
    physics: RealPhysicsName = "gymnasium",
    seed: Seed = 0,
    episode_length: Count = None,
    license_id: Annotated[str, arg(name="license", metavar="ID")] = "unknown",
    env: OwnEnv = None,
    terminal: TerminalOptions = TERMINAL,
) -> None:
    """Write a policy for other programs, or with a model card for other people.

    Example: ailsrs export runs/hopper --output policy.onnx

    Example: ailsrs export runs/hopper --output hopper --license apache-2.0

    Args:
        policy: A policy.npz or .safetensors, or the directory of a run with one seed.
        output: A file that ends in .onnx, .safetensors, .npz or .h (C); or a new directory for all
            of them and a model card for the Hugging Face Hub.
        episodes: Episodes for the return in the model card.
        episode_length: Steps of these; by default those of the run that the policy is in, else the
            environment's time limit.
        license_id: The policy's license as the Hub writes it: apache-2.0, mit, cc-by-4.0 and so on.
    """
    from ailsrs_jax.show.export import export

    allow(env)
    evaluation = export(
        policy,
        output,
        num_episodes=episodes,
        physics=physics,
        seed=seed,
        episode_length=episode_length,
        license_id=license_id,
    )
    result = f", return {evaluation} over {episodes} episodes" if evaluation else ""
    terminal.line(f"{policy} is now in {output}{result}")
    measured = evaluation_fields(evaluation) if evaluation else {}
    terminal.json({"policy": str(policy), "output": str(output), **measured})
