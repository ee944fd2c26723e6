"""What a run was asked to do, as written to ``config.json``."""

import dataclasses
import hashlib
import importlib.metadata
import json
from pathlib import Path
from typing import Any

from ailsrs_jax.data.demonstrations import Demonstrations
from ailsrs_jax.data.files import write_atomically
from ailsrs_jax.errors import UserError

VERSIONED_PACKAGES = ("ailsrs_jax", "jax", "mujoco", "gymnasium")


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
        """Write JSON, whole or not at all, with the versions of what computes the numbers."""
        versions = {name: importlib.metadata.version(name) for name in VERSIONED_PACKAGES}
        text = json.dumps(self._as_json() | {"versions": versions}, indent=2)
        write_atomically(path, lambda file: file.write(f"{text}\n".encode()))

    def require_same(self, path: Path) -> None:
        """Raise UserError, naming each difference, unless ``path`` holds this configuration."""
        try:
            saved = json.loads(path.read_text())
        except (OSError, ValueError) as error:
            raise UserError(f"nothing to resume: cannot read {path}") from error
        mine, saved = _flatten(self._as_json()), _flatten(saved)
        del mine["demonstrations"]  # their content counts, not the name of their file
        differences = [
            f"{name} is {mine[name]}, was {saved.get(name, 'not set')}"
            for name in mine
            if mine[name] != saved.get(name)
        ]
        if differences:
            raise UserError(f"cannot resume {path.parent}: {'; '.join(differences)}")

    def fingerprint(self) -> int:
        """A number that differs, in all likelihood, if anything of it does."""
        text = json.dumps({**self._as_json(), "demonstrations": None}, sort_keys=True)
        return int.from_bytes(hashlib.sha256(text.encode()).digest()[:4], "big") >> 1

    def _as_json(self) -> dict[str, Any]:
        fields: dict[str, Any] = json.loads(json.dumps(dataclasses.asdict(self)))
        return fields


def require_seed(seed: int) -> None:
    """Raise UserError unless ``seed`` is one that every random number generator here takes."""
    if not 0 <= seed < 2**31:
        raise UserError(f"seed is {seed}: it must be from 0 to {2**31 - 1}")


def _flatten(tree: Any, prefix: str = "") -> dict[str, Any]:
    if not isinstance(tree, dict):
        return {prefix.removesuffix("."): tree}
    return {k: v for key in tree for k, v in _flatten(tree[key], f"{prefix}{key}.").items()}


def content_hash(demonstrations: Demonstrations) -> str:
    """SHA-256 of what the demonstrations hold, whatever file they came from."""
    digest = hashlib.sha256()
    for name, array in demonstrations.fields().items():
        digest.update(f"{name} {array.dtype} {array.shape} ".encode() + array.tobytes())
    return digest.hexdigest()
