"""The cells of a sweep, and the file ``sweep.json`` that lists them."""

import dataclasses
import os
import re
from pathlib import Path
from typing import Any

from ailsrs_jax.errors import UserError, refusing
from ailsrs_jax.files import read_json_object, write_json
from ailsrs_jax.runs.plan import Plan, plan
from ailsrs_jax.runs.spec import RunSpec

MAX_SWEEP_BYTES = 2**26  # of sweep.json; a cell takes about 2000
PLAIN_NAME = re.compile(r"\w[\w.=+-]*")  # a cell's name, which is also the name of its directory


@dataclasses.dataclass(frozen=True)
class Cell:
    """One run of a sweep: an algorithm on a task with one seed."""

    name: str  # also of the cell's directory
    label: str  # what tables and figures call the cell
    # ``physics`` is the engine here if the task has a choice, so that all machines agree on "auto".
    # ``settings`` differ from the preset.
    spec: RunSpec
    all_settings: dict[str, Any]  # with those of the preset, which a later version may change
    engine: str
    program: str  # cells with the same one can be trained together
    demonstrations_sha256: str | None  # None for experts, which are simulated again where needed

    @property
    def seed(self) -> int:
        """The only seed of the cell."""
        return self.spec.seeds[0]

    def make_plan(self) -> Plan:
        """Plan the run of this cell.

        Raises:
            UserError: the run is impossible here, or its demonstrations have changed.
        """
        made = plan(self.spec)
        if self.demonstrations_sha256 not in (None, made.data.source_sha256):
            raise UserError(
                f"{self.spec.demonstrations} has changed since the sweep began: restore the file, "
                "or choose another output directory"
            )
        return made


@dataclasses.dataclass(frozen=True)
class Sweep:
    """A sweep as written to ``sweep.json``."""

    cells: tuple[Cell, ...]
    episodes: int  # in which each kept policy is evaluated

    def save(self, path: Path) -> None:
        """Write ``sweep.json``, unless this sweep is already there.

        Raises:
            UserError: another sweep is there, or the file cannot be written.
        """
        if os.path.lexists(path):  # Path.exists raises an error if the name is too long
            self.require_same(path)
            return
        write_json(path, dataclasses.asdict(self))

    def require_same(self, path: Path) -> None:
        """Raise UserError that names some differences unless ``path`` holds this sweep."""
        here, there = _flat(self), _flat(load_sweep(path))
        differences = [
            f"{key} is {here.get(key, 'gone')}, was {there.get(key, 'not there')}"
            for key in here | there
            if here.get(key) != there.get(key)
        ]
        if differences:
            more = f"; and {len(differences) - 3} more" if len(differences) > 3 else ""
            raise UserError(
                f"{path.parent} holds another sweep: {'; '.join(differences[:3])}{more}; choose "
                "another output directory"
            )


def _flat(sweep: Sweep) -> dict[str, Any]:
    """Return all values of a sweep with their names, for comparison; cells in their order."""
    values: dict[str, Any] = {"episodes": sweep.episodes, "the number of cells": len(sweep.cells)}
    values |= {f"cell {number}": cell.name for number, cell in enumerate(sweep.cells)}
    for cell in sweep.cells:
        fields = vars(cell) | vars(cell.spec) | cell.all_settings
        values |= {
            f"{name} of {cell.name}": value
            for name, value in fields.items()
            if name not in ("name", "spec", "all_settings")
        }
    return values


def load_sweep(path: Path) -> Sweep:
    """Read ``sweep.json``.

    Raises:
        UserError: the file is missing, damaged, or not of a sweep.
    """
    fields = read_json_object(path, "a sweep", MAX_SWEEP_BYTES)
    with refusing(f"{path} is not a sweep of this version, or damaged"):
        cells = tuple(map(_load_cell, fields["cells"]))
        if len({cell.name for cell in cells}) < len(cells) or type(fields["episodes"]) is not int:
            raise ValueError("a name is there twice, or episodes is not a number")
    return Sweep(cells, fields["episodes"])


def _load_cell(fields: dict[str, Any]) -> Cell:
    spec = RunSpec(**fields["spec"] | {"seeds": tuple(fields["spec"]["seeds"])})
    cell = Cell(**fields | {"spec": spec})
    if not PLAIN_NAME.fullmatch(cell.name):  # it becomes a directory
        raise ValueError("a name is not that of a directory")
    values = {**vars(cell), **vars(spec), "spec": None, "seeds": cell.seed}
    values |= {**values.pop("settings"), **values.pop("all_settings")}
    if len(spec.seeds) != 1 or any(isinstance(value, dict | list) for value in values.values()):
        raise ValueError("a value has the wrong type")
    return cell
