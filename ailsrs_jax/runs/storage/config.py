"""The configuration of a run, ``config.json``."""

import dataclasses
import functools
import hashlib
import importlib.metadata
import json
import re
import reprlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from flax.traverse_util import flatten_dict

from ailsrs_jax.data.sources import Source
from ailsrs_jax.errors import UserError
from ailsrs_jax.files import read_json_object, write_json

VERSIONED_PACKAGES = (
    *("ailsrs_jax", "jax", "jaxlib", "mujoco", "gymnasium", "numpy"),
    *("optax", "flax", "brax"),
)
MOST_DIFFERENCES = 8  # listed in an error message


@dataclasses.dataclass(frozen=True)
class RunConfig:
    """Everything that the numbers of a run depend on."""

    env_id: str
    physics: str  # the engine, never "auto"
    seeds: tuple[int, ...]
    algorithm: str
    preset: str
    settings: Any  # the algorithm's dataclass
    # These four are None for an algorithm that learns from the environment's reward.
    num_trajectories: int | None
    source: Source | None
    demonstrations_sha256: str | None  # of the arrays trained on
    subsample: int | None  # train on every k-th step

    def save(self, path: Path) -> None:
        """Write ``config.json`` atomically."""
        write_json(path, self.as_json())

    def require_same(self, saved: Mapping[str, Any], where: Path) -> None:
        """Raise UserError that lists the differences from ``saved``, which was read from ``where``.

        Versions of packages count, because other versions compute other numbers. The source of the
        demonstrations does not count, because their content does.
        """
        require_current(saved, where)
        mine = flatten_dict(self.as_json() | {"source": {}}, sep=".")
        differences = [
            f"{name} is {reprlib.repr(value)}, was {reprlib.repr(_at(saved, name))}"
            for name, value in mine.items()
            if value != _at(saved, name)
        ]
        if len(differences) > MOST_DIFFERENCES:
            more = len(differences) - MOST_DIFFERENCES
            differences[MOST_DIFFERENCES:] = [f"and {more} more differences"]
        if differences:
            hint = ""
            if all(difference.startswith("versions.") for difference in differences):
                hint = f"; install those versions, or edit {where} to go on with the present ones"
            raise UserError(f"cannot resume {where.parent}: {'; '.join(differences)}{hint}")

    def fingerprint(self) -> int:
        """Return a number that is almost surely different for a different configuration."""
        text = json.dumps(self.as_json() | {"source": None}, sort_keys=True)
        return int.from_bytes(hashlib.sha256(text.encode()).digest()[:4], "big") >> 1

    def as_json(self) -> dict[str, Any]:
        """Return the content of ``config.json``: these fields and the versions of packages."""
        fields = dataclasses.asdict(self) | {"versions": installed_versions()}
        as_read: dict[str, Any] = json.loads(json.dumps(fields))
        return as_read


@functools.cache
def installed_versions() -> dict[str, str]:
    """Return the versions of the packages that the numbers of a run depend on."""
    return {name: importlib.metadata.version(name) for name in VERSIONED_PACKAGES}


def read_config(path: Path) -> dict[str, Any]:
    """Read ``config.json``.

    Raises:
        UserError: it cannot be read, or is not a JSON object.
    """
    return read_json_object(path, "the configuration of a run")


def find_run(policy: Path) -> tuple[Path, int] | None:
    """Return the directory of the run that wrote the file ``policy``, and the seed, if any run."""
    seed, directory = policy.absolute().parent, policy.absolute().parent.parent
    found = re.fullmatch(r"seed_(\d{1,10})", seed.name)
    if found is None or not (directory / "config.json").exists():
        return None
    return directory, int(found[1])


def require_current(saved: Mapping[str, Any], where: Path) -> None:
    """Raise UserError if version 0.1 wrote ``saved``, which described its source in prose."""
    if "demonstrations" in saved and "source" not in saved:
        raise UserError(
            f"{where} was written by an older version: use that version to read it, or make the "
            "run again"
        )


def require_seed(seed: int) -> None:
    """Raise UserError unless every random number generator used here takes ``seed``."""
    if not 0 <= seed < 2**31:
        raise UserError(f"seed is {seed}: it must be from 0 to {2**31 - 1}")


def _at(tree: Any, name: str) -> Any:
    """Return the value that ``flatten_dict`` would call ``name``; a strange tree may be deep."""
    for key in name.split("."):
        tree = tree.get(key) if isinstance(tree, Mapping) else None
    return tree
