"""Checking the settings of a trainer, and changing them by name.

A setting's type says what it may be: an ``int`` is at least 1, a ``float`` not negative, others are
below.
"""

import dataclasses
import math
from typing import Annotated, Any, Literal, TypeVar, get_args, get_origin, get_type_hints

import jax
import numpy as np

from ailsrs_jax.errors import UserError, did_you_mean

Positive = Annotated[float, "positive"]
UpToOne = Annotated[float, "at most 1"]
PositiveUpToOne = Annotated[float, "positive", "at most 1"]
Signed = Annotated[float, "signed"]

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
    for name, kind in get_type_hints(type(settings), include_extras=True).items():
        value = getattr(settings, name)
        if not isinstance(value, jax.core.Tracer) and (must := _problem(value, kind)):
            raise UserError(f"setting {name} is {value}: it must {must}")
    if hasattr(settings, "num_top_directions"):
        top, most = settings.num_top_directions, settings.num_directions
        if top > most:
            raise UserError(
                f"setting num_top_directions is {top}: it must be from 1 to num_directions, {most}"
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


def _problem(value: Any, kind: Any) -> str:
    """What a setting of type ``kind`` must be that ``value`` is not; "" if nothing."""
    if get_origin(kind) is Literal:
        return "" if value in get_args(kind) else f"be {' or '.join(get_args(kind))}"
    type_, *bounds = get_args(kind) or (kind,)
    kinds, name = {
        bool: ("b", "true or false"),
        int: ("iu", "a whole number"),
        float: ("iuf", "a number"),
    }[type_]
    if type_ is not int or type(value) is not int:  # Python's whole numbers can be beyond NumPy's
        try:
            array = np.asarray(value)
        except ValueError:  # a ragged list
            return f"be {name}"
        if array.ndim > 0 or array.dtype.kind not in kinds:
            return f"be {name}"
    if type_ is int:
        return "be at least 1" if value < 1 else "be below 2^31" if value >= 2**31 else ""
    if not math.isfinite(value):
        return "be finite"
    if "positive" in bounds and value <= 0:
        return "be positive"
    if "signed" not in bounds and value < 0:
        return "not be negative"
    return "be at most 1" if "at most 1" in bounds and value > 1 else ""


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
