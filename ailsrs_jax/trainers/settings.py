"""Checking the settings of a trainer, and changing them by name."""

import dataclasses
import math
from typing import Any, Literal, TypeVar, get_args, get_origin, get_type_hints

import jax

from ailsrs_jax.errors import UserError, did_you_mean

POSITIVE = {
    "step_size",
    "noise_std",
    "discriminator_learning_rate",
    "learning_rate",
    "value_learning_rate",
    "max_divergence",
    "validation_fraction",
}
ANY_SIGN = {"survival_bonus", "stop_at"}
AT_MOST_ONE = {
    *("validation_fraction", "discount", "advantage_decay", "discounting", "gae_lambda"),
    "reward_after_end",
}

SettingsT = TypeVar("SettingsT")


def override(settings: SettingsT, assignments: dict[str, str]) -> SettingsT:
    """Replace fields of the dataclass ``settings`` by values given as text, and check the result.

    Raises:
        UserError: there is no such field, or the value makes no sense.
    """
    types = get_type_hints(type(settings))
    changes: dict[str, Any] = {}
    for name, text in assignments.items():
        if name not in types:
            hint = did_you_mean(name, types)
            raise UserError(f"there is no setting '{name}'{hint}: use one of {', '.join(types)}")
        changes[name] = _parse(name, text, types[name])
    changed = dataclasses.replace(settings, **changes)  # type: ignore[type-var]
    validate(changed)
    return changed


def as_text(value: Any) -> str:
    """A setting's value as :func:`override` takes it."""
    return str(value).lower() if isinstance(value, bool) else str(value)


def validate(settings: Any) -> None:
    """Raise UserError unless the values of a trainer's settings make sense; traced ones may."""
    values = {
        name: value
        for name, value in vars(settings).items()
        if not isinstance(value, jax.core.Tracer)
    }
    for name, value in values.items():
        if type(value) is int and value < 1:
            raise UserError(f"setting {name} is {value}: it must be at least 1")
        if type(value) is float and not math.isfinite(value):
            raise UserError(f"setting {name} is {value}: it must be finite")
        if name in POSITIVE and value <= 0:
            raise UserError(f"setting {name} is {value}: it must be positive")
        if type(value) is float and name not in ANY_SIGN and value < 0:
            raise UserError(f"setting {name} is {value}: it must not be negative")
        if name in AT_MOST_ONE and value > 1:
            raise UserError(f"setting {name} is {value}: it must be at most 1")
    if values.get("num_top_directions", 0) > values.get("num_directions", 0):
        raise UserError(
            f"setting num_top_directions is {values['num_top_directions']}: it must be from 1 to "
            f"num_directions, {values['num_directions']}"
        )


def require_countable(num_steps: int) -> None:
    """Raise UserError unless 32 bits can count the steps of an iteration, and what it remembers."""
    if num_steps >= 2**31:
        raise UserError(
            f"an iteration of {num_steps} steps, remembered ones included, is too long: they are "
            "counted in 32 bits, below 2^31"
        )


def is_used(weight: Any) -> bool:
    """Whether a term with this weight is there at all; a traced one, of stacked runs, is not 0."""
    return isinstance(weight, jax.core.Tracer) or weight != 0


def _parse(name: str, text: str, kind: Any) -> Any:
    choices = get_args(kind) if get_origin(kind) is Literal else ()
    if choices:
        if text in choices:
            return text
        expected = " or ".join(choices)
    elif kind is bool:
        if text.lower() in ("true", "false"):
            return text.lower() == "true"
        expected = "true or false"
    else:
        try:
            return kind(text)
        except ValueError:
            expected = "a whole number" if kind is int else "a number"
    raise UserError(f"setting {name} is '{text}': it must be {expected}")
