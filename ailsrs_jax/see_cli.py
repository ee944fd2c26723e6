"""The commands that show: ``ailsrs render`` and ``ailsrs report``."""

from pathlib import Path
from typing import Annotated

from rich.console import Console
from rich.markup import escape
from tyro.conf import Positional, arg

from ailsrs_jax.arguments import PhysicsName
from ailsrs_jax.errors import UserError

console = Console()


def render(
    policy: Positional[Annotated[Path, arg(metavar="DIR|POLICY")]],
    output: Annotated[Path, arg(metavar="FILE.mp4|FILE.html")],
    expert: Path | None = None,
    alone: bool = False,
    physics: PhysicsName = "auto",
    seed: int = 0,
    seconds: float = 10.0,
    size: int = 480,
) -> None:
    """Show one episode of a policy beside the expert's, from the same initial state.

    Example: ailsrs render runs/hopper --output hopper.mp4

    Args:
        policy: A policy.npz, or a run directory, of which the first seed is shown.
        output: A video, or a page with Brax's interactive viewer, which needs no renderer.
        expert: The expert's policy.npz; without it, the one that ships with the package, if any.
        alone: Show no expert.
        physics: mjx is pure JAX, mujoco the C engine; auto takes mjx where there is an accelerator.
        seed: Of the initial state.
        seconds: Show at most so many seconds of the episode, in real time.
        size: Height and width of each picture in pixels, an even number.
    """
    from ailsrs_jax import video

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
    console.print(f"{shown}: {escape(str(output))}", highlight=False, soft_wrap=True)


def report(
    directory: Positional[Annotated[Path, arg(metavar="DIR")]],
    output: Annotated[Path | None, arg(metavar="FILE.html")] = None,
    episodes: int = 100,
    video: bool = True,
) -> None:
    """Write one self-contained HTML page on a run or a sweep.

    Settings, curves, tables, a video, the command that made it, versions.

    Example: ailsrs report runs/hopper

    Args:
        directory: A run directory or a sweep's, finished or not.
        output: The page; by default report.html in the directory.
        episodes: Of each policy of a run, to measure its return.
        video: Show the policies, which takes the most time.
    """
    try:
        from ailsrs_jax import html_report
    except ImportError:
        raise UserError("a report needs pip install 'ailsrs_jax[plot]'") from None

    with console.status("writing the report"):
        path = html_report.report(directory, output, episodes=episodes, video=video)
    console.print(f"{escape(str(path))}", highlight=False, soft_wrap=True)
