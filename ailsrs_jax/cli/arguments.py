"""Options that several commands share."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

from tyro.conf import Positional, UseAppendAction, arg

from ailsrs_jax.errors import UserError


def maybe(metavar: str, text: str | None = None) -> Any:
    """Describe an option without "(default: None)": its help says what happens without it."""
    return arg(metavar=metavar, help=text, help_behavior_hint="")


EnvName = Annotated[
    str,
    arg(
        metavar="ENV",
        help="ant, halfcheetah, hopper, humanoid, swimmer, walker2d, any other environment of "
        "Gymnasium as gymnasium:ID, or module:attribute",
    ),
]
PolicyPath = Positional[Annotated[Path, arg(metavar="DIR|POLICY")]]
PhysicsName = Annotated[
    str,
    arg(
        metavar="auto|mjx|mujoco|warp",
        help="mjx is pure JAX, mujoco the C engine, warp MJX on NVIDIA's Warp; auto takes mjx if "
        "there is an accelerator.",
    ),
]
RealPhysicsName = Annotated[
    str,
    arg(
        metavar="gymnasium|auto|mjx|mujoco",
        help="gymnasium is the real environment, with the policy in NumPy.",
    ),
]
Seed = Annotated[int, arg(help="Seed of all random numbers, from 0.")]
Count = Annotated[int | None, maybe("N")]
OptionalPath = Annotated[Path | None, maybe("PATH")]
OwnEnv = Annotated[
    str | None,
    maybe(
        "NAME",
        "The task that the file names, if it is your own or a module of Gymnasium "
        "environments: such code is imported only if you repeat its name here.",
    ),
]
Flag = Annotated[bool, arg(help_behavior_hint="")]
TrackerName = Annotated[
    str | None,
    maybe(
        "wandb|trackio",
        "Also send the metrics to Weights & Biases or Trackio; needs the extra of that name.",
    ),
]
# Both "--set a=1 b=2" and "--set a=1 --set b=2".
Settings = Annotated[
    UseAppendAction[tuple[tuple[str, ...], ...]],
    arg(
        name="set",
        metavar="NAME=VALUE",
        help="Settings to change, as in --set num_iterations=50; a wrong name lists all of them.",
        help_behavior_hint="(repeatable)",
    ),
]


def assignments(groups: Sequence[Sequence[str]]) -> dict[str, str]:
    """Return the values of ``--set`` as text, by the name of the setting.

    Raises:
        UserError: one of them is not an assignment.
    """
    changes = {}
    for text in (text for group in groups for text in group):
        name, equals, value = text.partition("=")
        if not equals:
            raise UserError(f"--set {text}: write NAME=VALUE")
        changes[name.replace("-", "_")] = value
    return changes
