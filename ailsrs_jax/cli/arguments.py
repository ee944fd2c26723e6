"""Arguments that the commands share."""

from pathlib import Path
from typing import Annotated

from tyro.conf import UseAppendAction, arg

from ailsrs_jax.errors import UserError

EnvName = Annotated[
    str,
    arg(
        metavar="ENV",
        help="ant, halfcheetah, hopper, humanoid, swimmer, walker2d, or module:attribute",
    ),
]
AlgorithmName = Annotated[str, arg(metavar="ailsrs|bc|gail|ars|brs|trpo")]
# Where help would say "default: None" or "default: False", it says what happens instead.
Count = Annotated[int | None, arg(metavar="N", help_behavior_hint="")]
TrackerName = Annotated[str | None, arg(metavar="wandb|trackio", help_behavior_hint="")]
OptionalPath = Annotated[Path | None, arg(metavar="PATH", help_behavior_hint="")]
Source = Annotated[str | None, arg(metavar="SOURCE", help_behavior_hint="")]
Flag = Annotated[bool, arg(help_behavior_hint="")]
Quiet = Annotated[bool, arg(help="Print warnings and errors only.", help_behavior_hint="")]
Json = Annotated[
    bool,
    arg(
        name="json",
        help="Print one JSON object on standard output, and all else on standard error.",
        help_behavior_hint="",
    ),
]
PhysicsName = Annotated[str, arg(metavar="auto|mjx|mujoco")]
# Both "--set a=1 b=2" and "--set a=1 --set b=2".
Settings = Annotated[
    UseAppendAction[tuple[tuple[str, ...], ...]],
    arg(name="set", metavar="NAME=VALUE", help_behavior_hint="(repeatable)"),
]
Seeds = Annotated[
    UseAppendAction[tuple[tuple[int, ...], ...]], arg(metavar="SEED ...", help_behavior_hint="")
]


def assignments(
    groups: tuple[tuple[str, ...], ...], iterations: int | None = None
) -> dict[str, str]:
    """Settings to change, as text by name.

    Raises:
        UserError: one of them is not an assignment.
    """
    changes = {} if iterations is None else {"num_iterations": str(iterations)}
    for text in (text for group in groups for text in group):
        name, equals, value = text.partition("=")
        if not equals:
            raise UserError(f"--set {text}: write NAME=VALUE")
        changes[name.replace("-", "_")] = value
    return changes
