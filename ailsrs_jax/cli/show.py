"""The commands that show: ``ailsrs render`` and ``ailsrs report``."""

from pathlib import Path
from typing import Annotated

from rich.markup import escape
from tyro.conf import Positional, arg

from ailsrs_jax.cli.arguments import Flag, Json, OptionalPath, PhysicsName, Quiet
from ailsrs_jax.cli.console import make_console, print_json
from ailsrs_jax.errors import UserError
from ailsrs_jax.versions import VersionError


def render(
    policy: Positional[Annotated[Path, arg(metavar="DIR|POLICY")]],
    output: Annotated[Path, arg(metavar="FILE.mp4|FILE.html")],
    expert: OptionalPath = None,
    alone: Flag = False,
    physics: PhysicsName = "auto",
    seed: int = 0,
    seconds: float = 10.0,
    size: int = 480,
    quiet: Quiet = False,
    as_json: Json = False,
) -> None:
    """Show one episode of a policy beside the expert's, from the same initial state.

    Example: ailsrs render runs/hopper --output hopper.mp4

    Args:
        policy: A policy.npz, or a run directory, of which the first seed is shown.
        output: A video, or a page with Brax's interactive viewer, which needs no renderer.
        expert: The expert's policy.npz; without it, the one that ships with the package, if any.
        alone: Show no expert.
        physics: mjx is pure JAX, mujoco the C engine; auto takes mjx where there is an accelerator.
        seed: Of the initial state, from 0.
        seconds: Show at most so many seconds of the episode, in real time.
        size: Height and width of each picture in pixels, an even number.
    """
    from ailsrs_jax.show import video

    console = make_console(quiet=quiet, as_json=as_json)
    with console.status("rendering"):
        animation = video.render(
            policy,
            output,
            expert=expert,
            alone=alone,
            physics=physics,
            seed=seed,
            seconds=seconds,
            size=size,
        )
    shown = ", ".join(
        f"{label} {episode.num_steps} steps, return {episode.env_rewards.sum():.0f}"
        for label, episode in zip(animation.labels, animation.replays, strict=True)
    )
    console.print(f"{shown}: {escape(str(output))}", soft_wrap=True)
    if as_json:
        episodes = [
            {
                "label": label,
                "length": episode.num_steps,
                "return": float(episode.env_rewards.sum()),
            }
            for label, episode in zip(animation.labels, animation.replays, strict=True)
        ]
        print_json({"output": str(output), "episodes": episodes})


def report(
    directory: Positional[Annotated[Path, arg(metavar="DIR")]],
    output: Annotated[Path | None, arg(metavar="FILE.html", help_behavior_hint="")] = None,
    episodes: int = 100,
    no_video: Flag = False,
    quiet: Quiet = False,
    as_json: Json = False,
) -> None:
    """Write one self-contained HTML page on a run or a sweep.

    Settings, curves, tables, a video, the command that made it, versions.

    Example: ailsrs report runs/hopper

    Args:
        directory: A run directory or a sweep's, finished or not.
        output: The page; by default report.html in the directory.
        episodes: Of each policy of a run, to measure its return.
        no_video: Leave out the video of the policies, which takes the most time.
    """
    try:
        from ailsrs_jax.show import report as html_report
    except VersionError:
        raise
    except ImportError:
        raise UserError("a report needs pip install 'ailsrs_jax[plot]'") from None

    console = make_console(quiet=quiet, as_json=as_json)
    with console.status("writing the report"):
        path = html_report.report(directory, output, episodes=episodes, video=not no_video)
    console.print(escape(str(path)), soft_wrap=True)
    if as_json:
        print_json({"output": str(path)})
