"""The cells of a sweep, and the file that says which they are."""

import dataclasses
import json
import os
import re
from pathlib import Path
from typing import Any

from ailsrs_jax.envs.physics import ENGINES
from ailsrs_jax.envs.registry import takes_physics
from ailsrs_jax.errors import UserError, one_line
from ailsrs_jax.files import read_json_object, write_atomically
from ailsrs_jax.runs.plan import Plan, plan
from ailsrs_jax.runs.spec import RunSpec
from ailsrs_jax.trainers.algorithms import preset_settings
from ailsrs_jax.trainers.parts.settings import parse

PLAIN_NAME = re.compile(r"\w[\w.=+-]*")  # of a cell: a directory of its own, nowhere else
MAX_SWEEP = 2**26  # bytes of sweep.json; a cell has about 2000


@dataclasses.dataclass(frozen=True)
class Cell:
    """One algorithm × task × preset × number of trajectories × settings × seed."""

    name: str  # also of its directory
    label: str  # for people
    algorithm: str
    env_id: str
    preset: str
    settings: dict[str, str]  # what differs from the preset, sorted
    all_settings: dict[str, Any]  # the preset's as they were then, too
    demonstrations: str | None  # None for the shipped expert's, or none
    demonstrations_sha256: str | None  # of what they hold, of those that did not ship
    num_trajectories: int | None  # None where there are none
    subsample: int
    physics: str  # as asked for
    engine: str  # what that means here
    program: str  # cells with the same one can be trained together
    seed: int

    @property
    def decided_physics(self) -> str:
        """``physics``, but what ``auto`` means is not for each machine of a cluster to say."""
        decided = self.engine in ENGINES and takes_physics(self.env_id)
        return self.engine if decided else self.physics

    def make_plan(self) -> Plan:
        """The run of this cell alone.

        Raises:
            UserError: something of it is wrong, or its demonstrations are not what they were.
        """
        preset = preset_settings(self.env_id, self.preset, self.algorithm)
        spec = RunSpec(
            env=self.env_id,
            demonstrations=self.demonstrations,
            algorithm=self.algorithm,
            num_trajectories=self.num_trajectories,
            subsample=self.subsample,
            seeds=(self.seed,),
            preset=self.preset,
            settings=parse(preset, self.settings),
            physics=self.decided_physics,
        )
        made = plan(spec)
        if self.demonstrations_sha256 not in (None, made.config.demonstrations_sha256):
            raise UserError(
                f"{self.demonstrations} is not what it was when the sweep began: bring that back, "
                "or choose another output directory"
            )
        return made


@dataclasses.dataclass(frozen=True)
class Sweep:
    """All that is asked for, as written to ``sweep.json``."""

    cells: tuple[Cell, ...]
    episodes: int

    def save(self, path: Path) -> None:
        """Write ``sweep.json``, unless it is there and the same.

        Raises:
            UserError: there is another one, or it cannot be written.
        """
        if os.path.lexists(path):  # Path.exists raises where a name is too long
            self.require_same(path)
            return
        text = json.dumps(dataclasses.asdict(self), indent=1)
        write_atomically(path, lambda file: file.write(f"{text}\n".encode()))

    def require_same(self, path: Path) -> None:
        """Raise UserError, naming some differences, unless ``path`` holds this sweep."""
        saved = load_sweep(path)
        here, there = ({cell.name: cell for cell in sweep.cells} for sweep in (self, saved))
        differences = [
            f"{len(names)} cells {what}, {names[0]} for one"
            for what, names in (
                ("are new", [name for name in here if name not in there]),
                ("are not asked for any more", [name for name in there if name not in here]),
            )
            if names
        ]
        for name in here:
            if name in there and here[name] != there[name]:
                mine, theirs = (
                    vars(cell) | {"all_settings": None} | cell.all_settings
                    for cell in (here[name], there[name])
                )
                differences += [
                    f"{key} of {name} is {mine[key]}, was {theirs.get(key)}"
                    for key in mine
                    if mine[key] != theirs.get(key)
                ]
        if self.episodes != saved.episodes:
            differences.append(f"episodes is {self.episodes}, was {saved.episodes}")
        if not differences and self != saved:
            differences.append("the cells are in another order")
        if differences:
            more = f"; and {len(differences) - 3} more" if len(differences) > 3 else ""
            raise UserError(
                f"{path.parent} holds another sweep: {'; '.join(differences[:3])}{more}; choose "
                "another output directory"
            )


def load_sweep(path: Path) -> Sweep:
    """Read ``sweep.json``.

    Raises:
        UserError: it is missing, damaged, or something else's.
    """
    fields = read_json_object(path, "of a sweep", MAX_SWEEP)
    try:
        # An earlier version did not note what the demonstrations hold.
        cells = tuple(Cell(**{"demonstrations_sha256": None} | cell) for cell in fields["cells"])
        names = [cell.name for cell in cells]
        # They become directories.
        if len(set(names)) < len(names) or not all(map(PLAIN_NAME.fullmatch, names)):
            raise ValueError("a name is odd")
        if not all(map(_is_flat, cells)) or not isinstance(fields["episodes"], int):
            raise ValueError("a value is odd")
        return Sweep(cells, fields["episodes"])
    except (ValueError, TypeError, KeyError) as error:
        raise UserError(f"{path} is not of a sweep, or damaged: {one_line(error)}") from error


def _is_flat(cell: Cell) -> bool:
    """Whether a cell from a file has tables where they belong, and nowhere else."""
    tables = (cell.settings, cell.all_settings)
    values = [value for name, value in vars(cell).items() if not name.endswith("settings")]
    values += [value for table in tables if isinstance(table, dict) for value in table.values()]
    is_flat = not any(isinstance(value, dict | list) for value in values)
    return is_flat and all(isinstance(table, dict) for table in tables)
