"""Sweep files: a declarative grid that is expanded into cells and checked before anything runs."""

import dataclasses
import hashlib
import itertools
import math
import re
import tomllib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from ailsrs_jax.envs.registry import require_harmless
from ailsrs_jax.errors import UserError, did_you_mean, refusing, requirement
from ailsrs_jax.files import read_small
from ailsrs_jax.own_code import is_own, require_allowed
from ailsrs_jax.runs.plan import plan
from ailsrs_jax.runs.spec import RunSpec
from ailsrs_jax.runs.stacking import stack_key
from ailsrs_jax.runs.storage.config import require_seed
from ailsrs_jax.sweeps.cells import Cell, Sweep
from ailsrs_jax.trainers.algorithms import find_algorithm
from ailsrs_jax.trainers.parts.settings import as_text

# Keys of a grid entry with the type of their values, which are fields of RunSpec. Each may be a
# list, whose values are tried in turn; ``settings`` is a table of such values.
AXES: dict[str, type] = {
    "algorithm": str,
    "env": str,
    "preset": str,
    "physics": str,
    "demonstrations": str,
    "num_trajectories": int,
    "draw_from": int,
    "subsample": int,
    "states_only": bool,
    "seeds": int,
}
EXPECTED: dict[type | None, str] = {  # in messages; None stands for a setting
    str: "text",
    int: "a whole number",
    bool: "true or false",
    None: "a number, true, false or text",
}
KEYS = (*AXES, "settings", "label")
COMMON_KEYS = (*KEYS, "grid", "episodes")
EPISODES = 100  # in Gymnasium's environment, for each kept policy

MAX_CELLS = 10_000  # a larger grid is a mistake, and would take hours to check
MAX_LABEL = 80  # characters
MAX_NAME = 100  # characters; the names of files in a directory of that name are longer


def read_spec(path: Path) -> dict[str, Any]:
    """Read a sweep file.

    Raises:
        UserError: the file is not TOML, or names code that the user has not named; see
            :func:`~ailsrs_jax.own_code.allow`.
    """
    with refusing(f"{path} is not TOML"):
        spec = tomllib.loads(read_small(path).decode())
    entries = spec.get("grid")
    checks = {"env": require_harmless, "algorithm": require_allowed, "settings": require_allowed}
    # Values of the wrong type are left to expand().
    for table in (spec, *(entries if isinstance(entries, list) else ())):
        for key, check in checks.items() if isinstance(table, dict) else ():
            for name in _leaves(table.get(key)):
                if isinstance(name, str):
                    check(name, str(path), "--own")
    return spec


def _leaves(value: Any) -> Iterator[Any]:
    """Yield the values in nested lists and tables."""
    if isinstance(value, list | Mapping):
        for each in value.values() if isinstance(value, Mapping) else value:
            yield from _leaves(each)
    else:
        yield value


def expand(spec: Mapping[str, Any]) -> Sweep:
    """Expand ``spec`` into cells, each of which is checked like a run of its own.

    The cells are in the order of the grid entries. Within an entry the keys vary from slowest to
    fastest in the order of :data:`AXES`, and the settings in the order of their table before seeds.

    Raises:
        UserError: something is wrong. The message names the grid entry.
    """
    _require_keys("the sweep", spec, COMMON_KEYS)
    if any(isinstance(value, int) and abs(value) >= 2**63 for value in _leaves(spec)):
        # Python would refuse to print it in a message.
        raise UserError("the sweep has a whole number of more than 64 bits: write a smaller one")
    entries = spec.get("grid", [])
    if not isinstance(entries, list) or not entries:
        raise UserError("the sweep has no [[grid]] entry: write one for each block of runs")
    episodes = spec.get("episodes", EPISODES)
    if type(episodes) is not int or episodes < 1:
        raise UserError(f"episodes is {episodes!r}: it must be a whole number from 1")
    common = {key: value for key, value in spec.items() if key in KEYS}
    cells: dict[str, tuple[Cell, str]] = {}
    for number, entry in enumerate(entries, start=1):
        where = f"grid entry {number}"
        if isinstance(entry, dict) and isinstance(entry.get("label"), str):
            where += f" ({entry['label']})"
        for cell in _expand_entry(where, common, entry):
            if cell.name in cells:
                raise UserError(f"{where}: {cell.name} is already in {cells[cell.name][1]}")
            cells[cell.name] = cell, where
            if len(cells) > MAX_CELLS:
                raise UserError(f"{where}: the sweep has more than {MAX_CELLS:,} cells")
    return Sweep(tuple(cell for cell, _ in cells.values()), episodes)


def _expand_entry(where: str, common: dict[str, Any], entry: Any) -> Iterator[Cell]:
    require = requirement(where)
    require(isinstance(entry, dict), "it must be a table, [[grid]]")
    _require_keys(where, entry, KEYS)
    given = {"seeds": 0} | common | entry
    require(given.get("env") is not None, "there is no env")
    label = given.get("label")
    if label is not None:
        problem = f"label is {label!r}: it must"
        require(isinstance(label, str), f"{problem} be one text for the whole entry")
        is_plain = label.isprintable() and 0 < len(label) <= MAX_LABEL
        require(is_plain, f"{problem} have 1 to {MAX_LABEL} printable characters")
    settings: dict[str, Any] = {}
    for table in (common.get("settings", {}), entry.get("settings", {})):
        require(isinstance(table, dict), f"settings is {table!r}: it must be a table")
        settings |= table
    seeds = _values(where, "seeds", given["seeds"])
    options = [key for key in AXES if given.get(key) is not None and key != "seeds"]
    axes = [_values(where, key, given[key]) for key in options]
    axes += [_values(where, f"settings.{name}", value) for name, value in settings.items()]
    number = math.prod(map(len, axes)) * len(seeds)
    require(number <= MAX_CELLS, f"it stands for more than {MAX_CELLS:,} cells")
    for values in itertools.product(*axes):
        point = dict(zip(options, values))
        changes = dict(zip(settings, values[len(options) :]))
        spec = RunSpec(**point, settings=changes, seeds=tuple(seeds))
        try:
            yield from _check(spec, label)
        except UserError as error:
            at = f"{spec.algorithm}, {spec.env}, {spec.num_trajectories}"
            raise UserError(f"{where} ({at}): {error}") from error


def _check(asked: RunSpec, label: str | None) -> list[Cell]:
    """Make the cells of all seeds of ``asked``, of which the first is planned."""
    for seed in asked.seeds:
        require_seed(seed)
    planned = plan(dataclasses.replace(asked, seeds=asked.seeds[:1]))
    planned.check()
    config = planned.config
    spec = dataclasses.replace(
        asked,
        env=config.env_id,
        num_trajectories=config.num_trajectories,
        settings=planned.spec.settings,
    )
    name = _name(spec)
    physics = planned.spec.physics  # resolved, so that "auto" means the same on all machines
    is_expert = config.source is None or config.source.kind == "expert"
    # Each seed draws its own demonstrations, and your own algorithm is not stacked over those.
    is_alone = is_own(config.algorithm) and spec.draw_from is not None

    def program(seed: int) -> str:
        key = (stack_key(planned), seed) if is_alone else stack_key(planned)
        return hashlib.sha256(repr(key).encode()).hexdigest()[:12]

    return [
        Cell(
            name=f"{name}-seed{seed}",
            label=label or find_algorithm(config.algorithm).title,
            spec=dataclasses.replace(spec, seeds=(seed,), physics=physics),
            all_settings=dataclasses.asdict(config.settings),
            engine=config.physics,
            program=program(seed),
            demonstrations_sha256=None if is_expert else planned.data.source_sha256,
        )
        for seed in asked.seeds
    ]


def _name(spec: RunSpec) -> str:
    """Make a name that tells cells apart, and does not depend on the rest of the sweep."""
    parts = [str(spec.env).removesuffix("-v5").lower(), spec.algorithm]
    if spec.num_trajectories is not None:
        parts.append(str(spec.num_trajectories))
    if spec.preset != RunSpec.preset:
        parts.append(spec.preset)
    others = {
        key: getattr(spec, key)
        for key in ("physics", "demonstrations", "draw_from", "subsample", "states_only")
        if getattr(spec, key) != getattr(RunSpec, key)
    }
    parts += [f"{name}={as_text(value)}" for name, value in {**others, **spec.settings}.items()]
    name = "-".join(parts)
    plain = re.sub(r"[^\w.=+-]", "_", name)
    if plain != name or len(plain) > MAX_NAME:
        plain = f"{plain[:MAX_NAME]}-{hashlib.sha256(name.encode()).hexdigest()[:8]}"
    return plain


def _require_keys(where: str, table: Mapping[str, Any], known: tuple[str, ...]) -> None:
    for key in table:
        if key not in known:
            hint = did_you_mean(key, known)
            raise UserError(
                f"{where}: there is no key '{key}'{hint}: use one of {', '.join(known)}"
            )


def _values(where: str, key: str, value: Any) -> list[Any]:
    """Return ``value`` as a list of different values of the right type."""
    require = requirement(where)
    values = value if isinstance(value, list) else [value]
    require(bool(values), f"{key} is an empty list")
    kind = AXES.get(key)
    for each in values:
        fits = isinstance(each, bool | int | float | str) if kind is None else type(each) is kind
        require(fits, f"{key} is {each!r}: it must be {EXPECTED[kind]}")
    differ = len(set(map(str, values))) == len(values)
    require(differ, f"{key} holds the same value twice: {value}")
    return values
