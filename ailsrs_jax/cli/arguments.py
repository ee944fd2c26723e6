"""Options that several commands share."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, UseAppendAction, arg

from ailsrs_jax.errors import UserError
from ailsrs_jax.own_code import allow

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
# An empty hint replaces "(default: None)" and "(default: False)"; the help says what happens.
Count = Annotated[int | None, arg(metavar="N", help_behavior_hint="")]
OptionalPath = Annotated[Path | None, arg(metavar="PATH", help_behavior_hint="")]
OwnEnv = Annotated[
    str | None,
    arg(
        metavar="NAME",
        help="The task that the file names, if it is your own or a module of Gymnasium "
        "environments: such code is imported only if you repeat its name here.",
        help_behavior_hint="",
    ),
]
Flag = Annotated[bool, arg(help_behavior_hint="")]
TrackerName = Annotated[
    str | None,
    arg(
        metavar="wandb|trackio",
        help="Also send the metrics to Weights & Biases or Trackio; needs the extra of that name.",
        help_behavior_hint="",
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


def allow_env(name: str | None) -> None:
    """Allow a file to name this environment; see :mod:`ailsrs_jax.own_code`."""
    if name is not None:
        allow(name)


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
