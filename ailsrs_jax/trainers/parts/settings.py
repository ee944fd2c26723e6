"""Check the settings of a trainer, and change them by name.

The type of a field says which values it takes. An ``int`` is at least 1 and a ``float`` is not
negative; the types below say otherwise.
"""

import dataclasses
import math
import re
from collections.abc import Mapping
from typing import Annotated, Any, Literal, TypeVar, get_args, get_origin, get_type_hints

import jax
import numpy as np

from ailsrs_jax.errors import UserError, did_you_mean

FromZero = Annotated[int, "from 0"]
Positive = Annotated[float, "positive"]
UpToOne = Annotated[float, "at most 1"]
PositiveUpToOne = Annotated[float, "positive", "at most 1"]
FromOne = Annotated[float, "at least 1"]
Signed = Annotated[float, "signed"]
Entries = Annotated[str, re.compile(r"all|\d+:\d+")]  # of an observation; see :func:`parse_entries`

SettingsT = TypeVar("SettingsT")


def override(settings: SettingsT, changes: Mapping[str, Any]) -> SettingsT:
    """Replace fields of the dataclass ``settings`` by typed values, and check the result.

    Raises:
        UserError: a field does not exist, or its value makes no sense.
    """
    types = _types(settings, changes)
    typed = {name: _as_type(value, types[name]) for name, value in changes.items()}
    changed = dataclasses.replace(settings, **typed)  # type: ignore[type-var]
    validate(changed)
    return changed


def parse(settings: Any, assignments: Mapping[str, str]) -> dict[str, Any]:
    """Turn values given as text into the types of the fields of ``settings``.

    Raises:
        UserError: a field does not exist, or the text is no such value.
    """
    types = _types(settings, assignments)
    return {name: _parse(name, text, types[name]) for name, text in assignments.items()}


def as_text(value: Any) -> str:
    """Write a value as :func:`parse` reads it."""
    return str(value).lower() if isinstance(value, bool) else str(value)


def validate(settings: Any) -> None:
    """Raise UserError unless all values make sense; traced values are not looked at."""
    for name, kind in get_type_hints(type(settings), include_extras=True).items():
        value = getattr(settings, name)
        if not isinstance(value, jax.core.Tracer) and (must := _problem(value, kind)):
            raise UserError(f"setting {name} is {value}: it must {must}")
    if hasattr(settings, "num_top_directions"):
        top, most = settings.num_top_directions, settings.num_directions
        if top > most:
            raise UserError(
                f"setting num_top_directions is {top}: it must be at most num_directions, {most}"
            )


def require_countable(num_steps: int) -> None:
    """Raise UserError unless 32 bits can count the steps of an iteration and of the memory."""
    if num_steps >= 2**31:
        raise UserError(
            f"an iteration of {num_steps} steps, remembered ones included, is too long: they are "
            "counted in 32 bits, below 2^31"
        )


def parse_entries(text: str, size: int) -> tuple[int, int]:
    """Return the first entry and the one after the last, of an observation of ``size`` entries.

    Raises:
        UserError: there are no such entries.
    """
    if text == "all":
        return 0, size
    first, end = map(int, text.split(":"))
    if not first < end <= size:
        raise UserError(f"entries {text} are not among the {size} of an observation: use 0:{size}")
    return first, end


def is_used(weight: Any) -> bool:
    """Tell whether a term with this weight is computed; a traced weight is never 0."""
    return isinstance(weight, jax.core.Tracer) or weight != 0


def _types(settings: Any, names: Mapping[str, Any]) -> dict[str, Any]:
    types = get_type_hints(type(settings))
    for name in names:
        if name not in types:
            hint = did_you_mean(name, types)
            raise UserError(f"there is no setting '{name}'{hint}: use one of {', '.join(types)}")
    return types


def _as_type(value: Any, kind: Any) -> Any:
    """Return a plain Python value; a whole number may stand for a real one."""
    if isinstance(value, np.generic | np.ndarray | jax.Array) and value.ndim == 0:
        value = value.item()
    is_whole = type(value) is int and abs(value) < 2**63
    return float(value) if kind is float and is_whole else value


def _problem(value: Any, kind: Any) -> str:
    """Say what a setting of type ``kind`` must be and ``value`` is not; "" if all is well."""
    if get_origin(kind) is Literal:
        return "" if value in get_args(kind) else f"be {' or '.join(get_args(kind))}"
    type_, *bounds = get_args(kind) or (kind,)
    kinds, name = {
        bool: ("b", "true or false"),
        int: ("iu", "a whole number"),
        float: ("iuf", "a number"),
        str: ("U", "text"),
    }[type_]
    if type_ is not int or type(value) is not int:  # Python's integers can exceed NumPy's
        try:
            array = np.asarray(value)
        except ValueError:  # a ragged list
            return f"be {name}"
        if array.ndim > 0 or array.dtype.kind not in kinds:
            return f"be {name}"
    if type_ is str:
        known = bounds[0]
        if isinstance(known, re.Pattern):
            return "" if known.fullmatch(value) else f"match {known.pattern}"
        own = "a function of your own, module:attribute"
        return "" if value in known or ":" in value else f"be {', '.join(known)} or {own}"
    if type_ is int:
        lowest = 0 if "from 0" in bounds else 1
        if value < lowest:
            return f"be at least {lowest}"
        return "be below 2^31" if value >= 2**31 else ""
    if not math.isfinite(value):
        return "be finite"
    if "positive" in bounds and value <= 0:
        return "be positive"
    if "signed" not in bounds and value < 0:
        return "not be negative"
    if "at least 1" in bounds and value < 1:
        return "be at least 1"
    return "be at most 1" if "at most 1" in bounds and value > 1 else ""


def _parse(name: str, text: str, kind: Any) -> Any:
    if kind is str:
        return text
    if get_origin(kind) is Literal:
        choices = get_args(kind)
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
