"""What a run was asked to do, as written to ``config.json``."""

import dataclasses
import hashlib
import importlib.metadata
import json
import reprlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ailsrs_jax.data.demonstrations import Demonstrations
from ailsrs_jax.errors import UserError
from ailsrs_jax.files import read_json_object, write_atomically

VERSIONED_PACKAGES = (
    *("ailsrs_jax", "jax", "jaxlib", "mujoco", "gymnasium", "numpy"),
    *("optax", "flax", "brax"),
)

MOST_DIFFERENCES = 8  # that are told in a line


@dataclasses.dataclass(frozen=True)
class RunConfig:
    """Everything that a run's numbers depend on."""

    env_id: str
    physics: str  # the engine, never "auto"
    seeds: tuple[int, ...]
    algorithm: str
    preset: str
    settings: Any  # the algorithm's dataclass
    # Where there are none, the algorithm learns from the environment's reward.
    num_trajectories: int | None
    demonstrations: str | None  # where they are from, or which expert they are of
    demonstrations_sha256: str | None  # of what is trained on
    subsample: int | None  # only every k-th of their steps is

    def save(self, path: Path) -> None:
        """Write JSON, whole or not at all."""
        text = json.dumps(self.as_json(), indent=2)
        write_atomically(path, lambda file: file.write(f"{text}\n".encode()))

    def require_same(self, saved: Mapping[str, Any], where: Path) -> None:
        """Raise UserError, naming each difference, unless ``saved``, found ``where``, is this.

        Versions of packages count where they are told: with others the numbers would be others.
        """
        mine = _flatten(self.as_json())
        del mine["demonstrations"]  # their content counts, not the name of their file
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
                hint = f"; install those, or, to go on with these, change them in {where}"
            raise UserError(f"cannot resume {where.parent}: {'; '.join(differences)}{hint}")

    def fingerprint(self) -> int:
        """A number that differs, in all likelihood, if anything of it does."""
        text = json.dumps({**self.as_json(), "demonstrations": None}, sort_keys=True)
        return int.from_bytes(hashlib.sha256(text.encode()).digest()[:4], "big") >> 1

    def as_json(self) -> dict[str, Any]:
        """What ``config.json`` holds: this, and the versions of what computes the numbers."""
        fields = dataclasses.asdict(self) | {"versions": installed_versions()}
        as_read: dict[str, Any] = json.loads(json.dumps(fields))
        return as_read


def installed_versions() -> dict[str, str]:
    """Of what the numbers of a run depend on."""
    return {name: importlib.metadata.version(name) for name in VERSIONED_PACKAGES}


def read_config(path: Path) -> dict[str, Any]:
    """What ``config.json`` holds.

    Raises:
        UserError: it cannot be read, or is no such file.
    """
    return read_json_object(path, "the configuration of a run")


def require_seed(seed: int) -> None:
    """Raise UserError unless ``seed`` is one that every random number generator here takes."""
    if not 0 <= seed < 2**31:
        raise UserError(f"seed is {seed}: it must be from 0 to {2**31 - 1}")


def _flatten(tree: Any, prefix: str = "") -> dict[str, Any]:
    if not isinstance(tree, dict):
        return {prefix.removesuffix("."): tree}
    return {k: v for key in tree for k, v in _flatten(tree[key], f"{prefix}{key}.").items()}


def _at(tree: Any, name: str) -> Any:
    """What ``_flatten`` would call ``name`` in a tree from a file, which can be of any depth."""
    for key in name.split("."):
        tree = tree.get(key) if isinstance(tree, Mapping) else None
    return tree


def content_hash(demonstrations: Demonstrations) -> str:
    """SHA-256 of what the demonstrations hold, whatever file they came from."""
    digest = hashlib.sha256()
    for name, array in demonstrations.fields().items():
        digest.update(f"{name} {array.dtype} {array.shape} ".encode() + array.tobytes())
    return digest.hexdigest()
