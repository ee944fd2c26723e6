"""The commands that show: ``ailsrs render`` and ``ailsrs report``."""

from pathlib import Path
from typing import Annotated

from rich.console import Console
from rich.markup import escape
from tyro.conf import Positional, arg

from ailsrs_jax.arguments import PhysicsName

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
