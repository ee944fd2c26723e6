"""What a sweep is to do: a declarative grid, expanded into cells and checked as a whole."""

import dataclasses
import hashlib
import itertools
import math
import re
import tomllib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import jax

from ailsrs_jax.data.sources import PAPER_EXPERT
from ailsrs_jax.envs.registry import require_harmless
from ailsrs_jax.errors import UserError, did_you_mean, one_line
from ailsrs_jax.files import read_small
from ailsrs_jax.runs.plan import plan as make_plan
from ailsrs_jax.runs.spec import RunSpec
from ailsrs_jax.runs.stacking import stack_key
from ailsrs_jax.runs.storage.config import require_seed
from ailsrs_jax.sweeps.cells import Cell, Sweep
from ailsrs_jax.trainers.algorithms import changed_settings
from ailsrs_jax.trainers.parts.settings import as_text

# Keys of a grid entry, or common to all of them, with the type of their values; any of these may be
# a list, whose elements are tried in turn. ``settings`` is a table of such values.
AXES: dict[str, type] = {
    "algorithm": str,
    "env": str,
    "preset": str,
    "physics": str,
    "demonstrations": str,
    "num_trajectories": int,
    "subsample": int,
    "seeds": int,
}
KEYS = (*AXES, "settings", "label")
COMMON_KEYS = (*KEYS, "grid", "episodes")
DEFAULTS: dict[str, Any] = {
    "algorithm": "ailsrs",
    "preset": "tuned",
    "physics": "auto",
    "demonstrations": None,
    "num_trajectories": None,
    "subsample": 1,
    "seeds": 0,
}
EPISODES = 100  # of each kept policy, in Gymnasium's own environment

MOST_CELLS = 10_000  # more is a mistake, and would take hours to check

LONGEST_LABEL = 80  # characters
LONGEST_NAME = 100  # characters; with room for what files in a directory of that name are called


def read_spec(path: Path) -> dict[str, Any]:
    """Read a TOML file.

    Raises:
        UserError: it cannot be read, is not TOML, or names an environment that is not safe to open.
    """
    try:
        spec = tomllib.loads(read_small(path).decode())
    except UserError:
        raise
    except (ValueError, RecursionError) as error:
        raise UserError(f"{path} is not TOML: {one_line(error)}") from error
    entries = spec.get("grid")
    for table in (spec, *(entries if isinstance(entries, list) else ())):
        names = table.get("env") if isinstance(table, dict) else None
        for name in names if isinstance(names, list) else (names,):
            if isinstance(name, str):  # what else it may be, expand() says
                require_harmless(name, str(path))
    return spec


def expand(spec: Mapping[str, Any]) -> Sweep:
    """All cells of ``spec``, in its order, each checked as a run of its own would be.

    Later grid entries come later; of an entry the keys in the order of :data:`AXES` vary from
    slowest to fastest, the settings in the order of their table before the seeds.

    Raises:
        UserError: something is wrong; the message names the grid entry.
    """
    _require_keys("the sweep", spec, COMMON_KEYS)
    _require_ordinary_numbers(spec)
    entries = spec.get("grid", [])
    if not isinstance(entries, list) or not entries:
        raise UserError("the sweep has no [[grid]] entry: write one for each block of runs")
    episodes = spec.get("episodes", EPISODES)
    if type(episodes) is not int or episodes < 1:
        raise UserError(f"episodes is {episodes!r}: it must be a whole number from 1")
    common = {key: value for key, value in spec.items() if key in KEYS}
    cells: dict[str, Cell] = {}
    made_by: dict[str, str] = {}
    for number, entry in enumerate(entries, start=1):
        where = f"grid entry {number}"
        if isinstance(entry, dict) and isinstance(entry.get("label"), str):
            where += f" ({entry['label']})"
        for cell in _expand_entry(where, common, entry):
            if cell.name in cells:
                raise UserError(f"{where}: {cell.name} is already in {made_by[cell.name]}")
            cells[cell.name] = cell
            made_by[cell.name] = where
            if len(cells) > MOST_CELLS:
                raise UserError(f"{where}: the sweep has more than {MOST_CELLS:,} cells")
    return Sweep(tuple(cells.values()), episodes)


def _expand_entry(where: str, common: dict[str, Any], entry: Any) -> Iterator[Cell]:
    if not isinstance(entry, dict):
        raise UserError(f"{where}: it must be a table, [[grid]]")
    _require_keys(where, entry, KEYS)
    given = DEFAULTS | common | entry
    if "env" not in given:
        raise UserError(f"{where}: there is no env")
    label = given.get("label")
    if not (label is None or isinstance(label, str)):
        raise UserError(f"{where}: label is {label!r}: it must be one text, for all of the entry")
    if label is not None and not (label.isprintable() and 0 < len(label) <= LONGEST_LABEL):
        raise UserError(
            f"{where}: label is {label!r}: it must be of 1 to {LONGEST_LABEL} printable characters"
        )
    tables = [table.get("settings", {}) for table in (common, entry)]
    for table in tables:
        if not isinstance(table, dict):
            raise UserError(f"{where}: settings is {table!r}: it must be a table")
    settings = {f"settings.{name}": value for table in tables for name, value in table.items()}
    seeds = _values(where, "seeds", given["seeds"])
    axes = {key: _values(where, key, given[key]) for key in AXES if key != "seeds"}
    axes |= {key: _values(where, key, value) for key, value in settings.items()}
    if math.prod(map(len, axes.values())) * len(seeds) > MOST_CELLS:
        raise UserError(f"{where}: it stands for more than {MOST_CELLS:,} cells")
    for values in itertools.product(*axes.values()):
        point = dict(zip(axes, values, strict=True))
        yield from _check_group(where, point, seeds, label)


def _check_group(
    where: str, point: dict[str, Any], seeds: list[int], label: str | None
) -> Iterator[Cell]:
    """The cells of one point of the grid, which differ in nothing but the seed."""
    settings = {
        key.removeprefix("settings."): value
        for key, value in point.items()
        if key.startswith("settings.")
    }
    try:
        for seed in seeds:
            require_seed(seed)
        spec = RunSpec(
            env=point["env"],
            demonstrations=point["demonstrations"],
            algorithm=point["algorithm"],
            num_trajectories=point["num_trajectories"],
            subsample=point["subsample"],
            seeds=seeds[:1],
            preset=point["preset"],
            settings=settings,
            physics=point["physics"],
        )
        plan = make_plan(spec)
        jax.eval_shape(lambda: (plan.make_trainer(), 0)[1])  # what it refuses, at no cost
    except UserError as error:
        at = ", ".join(str(point[key]) for key in ("algorithm", "env", "num_trajectories"))
        raise UserError(f"{where} ({at}): {error}") from error
    config = plan.config
    named = point["demonstrations"] if plan.algorithm.imitates else None
    cell = Cell(
        name="",
        label=label or plan.algorithm.title,
        algorithm=config.algorithm,
        env_id=config.env_id,
        preset=config.preset,
        settings={
            name: as_text(value)
            for name, value in changed_settings(
                config.env_id, config.preset, config.algorithm, vars(config.settings)
            ).items()
        },
        all_settings=dataclasses.asdict(config.settings),
        demonstrations=named,
        # The shipped experts' are simulated where they are needed, and differ by roundings.
        demonstrations_sha256=(
            None if named in (None, PAPER_EXPERT) else config.demonstrations_sha256
        ),
        num_trajectories=config.num_trajectories,
        subsample=point["subsample"],
        physics=point["physics"],
        engine=config.physics,
        program=hashlib.sha256(repr(stack_key(plan)).encode()).hexdigest()[:12],
        seed=0,
    )
    for seed in seeds:
        yield dataclasses.replace(cell, seed=seed, name=_name(cell, seed))


def _name(cell: Cell, seed: int) -> str:
    """Different for different cells, and the same whatever else is in the sweep."""
    parts = [cell.env_id.removesuffix("-v5").lower(), cell.algorithm]
    if cell.num_trajectories is not None:
        parts.append(str(cell.num_trajectories))
    if cell.preset != DEFAULTS["preset"]:
        parts.append(cell.preset)
    others = {
        key: getattr(cell, key)
        for key in ("physics", "demonstrations", "subsample")
        if getattr(cell, key) != DEFAULTS[key]
    }
    parts += [f"{name}={value}" for name, value in (others | cell.settings).items()]
    name = "-".join(parts)
    plain = re.sub(r"[^\w.=+-]", "_", name)
    if plain != name or len(plain) > LONGEST_NAME:
        plain = f"{plain[:LONGEST_NAME]}-{hashlib.sha256(name.encode()).hexdigest()[:8]}"
    return f"{plain}-seed{seed}"


def _require_ordinary_numbers(value: Any) -> None:
    """Raise UserError where a whole number is so long that Python does not even print it."""
    if isinstance(value, Mapping | list):
        for each in value.values() if isinstance(value, Mapping) else value:
            _require_ordinary_numbers(each)
    elif isinstance(value, int) and abs(value) >= 2**63:
        raise UserError("the sweep has a whole number that no computer counts to")


def _require_keys(where: str, table: Mapping[str, Any], known: tuple[str, ...]) -> None:
    for key in table:
        if key not in known:
            hint = did_you_mean(key, known)
            raise UserError(
                f"{where}: there is no key '{key}'{hint}: use one of {', '.join(known)}"
            )


def _values(where: str, key: str, value: Any) -> list[Any]:
    """``value`` as a list of different values, each of the right type."""
    values = value if isinstance(value, list) else [value]
    if not values:
        raise UserError(f"{where}: {key} is an empty list")
    if value is None:
        return values
    for each in values:
        if key in AXES:
            if type(each) is not AXES[key]:
                expected = "text" if AXES[key] is str else "a whole number"
                raise UserError(f"{where}: {key} is {each!r}: it must be {expected}")
        elif not isinstance(each, bool | int | float | str):
            raise UserError(f"{where}: {key} is {each!r}: it must be a number, true, false or text")
    if len(set(map(str, values))) < len(values):
        raise UserError(f"{where}: {key} holds the same value twice: {value}")
    return values
