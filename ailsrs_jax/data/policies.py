"""Linear policies on disk, and as NumPy functions that drive any Gymnasium environment."""

import dataclasses
from importlib import resources
from pathlib import Path

import numpy as np

from ailsrs_jax.data.files import read_npz, write_atomically
from ailsrs_jax.errors import UserError

ARRAYS = ("weights", "mean", "std", "action_low", "action_high")


@dataclasses.dataclass(frozen=True, eq=False)
class SavedPolicy:
    """``policy.npz``: action = clip(weights @ ((observation − mean) / std), low, high)."""

    weights: np.ndarray  # (p, n)
    mean: np.ndarray  # (n,)
    std: np.ndarray  # (n,)
    action_low: np.ndarray  # (p,)
    action_high: np.ndarray  # (p,)
    env_id: str

    def __call__(self, observation: np.ndarray) -> np.ndarray:
        """The action ``(p,)`` for one observation ``(n,)``."""
        action = self.weights @ ((observation - self.mean) / self.std)
        return np.clip(action, self.action_low, self.action_high)

    def require_shape(self, action_size: int, observation_size: int) -> None:
        """Raise UserError unless this is a policy for so many actions and observations."""
        if self.weights.shape != (action_size, observation_size):
            raise UserError(
                f"the policy's weights are {self.weights.shape}: the environment needs "
                f"{(action_size, observation_size)}"
            )

    def save(self, path: str | Path) -> None:
        """Write a ``.npz`` file, whole or not at all."""
        fields = dataclasses.asdict(self)
        write_atomically(path, lambda file: np.savez(file, **fields))


def load_policy(path: str | Path) -> SavedPolicy:
    """Read and validate ``policy.npz``.

    Raises:
        UserError: the file is missing, is not such a file, or its contents contradict one another.
    """
    path = Path(path)
    fields = read_npz(path, (*ARRAYS, "env_id"), "a policy")
    weights = fields["weights"]
    if weights.ndim != 2:
        raise UserError(f"{path}: weights are {weights.shape}, not (p, n)")
    num_actions, num_observations = weights.shape
    shapes = {
        "mean": (num_observations,),
        "std": (num_observations,),
        "action_low": (num_actions,),
        "action_high": (num_actions,),
    }
    for name, shape in shapes.items():
        if fields[name].shape != shape:
            raise UserError(f"{path}: {name} is {fields[name].shape}, not {shape}")
    for name in ARRAYS:
        if fields[name].dtype.kind != "f" or not np.isfinite(fields[name]).all():
            raise UserError(f"{path}: {name} is not made of finite floating-point numbers")
    if not (fields["std"] > 0).all():
        raise UserError(f"{path}: std is not positive")
    if fields["env_id"].ndim != 0 or fields["env_id"].dtype.kind != "U":
        raise UserError(f"{path}: env_id is not a single string")
    return SavedPolicy(**{name: fields[name] for name in ARRAYS}, env_id=str(fields["env_id"]))


def policy_files(path: Path) -> list[Path]:
    """The policy file ``path`` itself, or those of every seed of the run directory ``path``.

    Raises:
        UserError: it is a directory without any, or cannot be looked into.
    """
    try:
        paths = sorted(path.glob("seed_*/policy.npz")) if path.is_dir() else [path]
    except OSError as error:
        raise UserError(f"cannot read {path}: {error.strerror}") from error
    if not paths:
        raise UserError(f"{path} holds no seed_*/policy.npz: is it a finished run?")
    return paths


def expert_path(env_id: str) -> Path:
    """The file of the expert that ships with the package for ``env_id``.

    Raises:
        UserError: none ships for this task.
    """
    path = Path(str(resources.files("ailsrs_jax.data"))) / "experts" / f"{env_id}.npz"
    if not path.is_file():
        raise UserError(
            f"no expert of {env_id} ships with the package: use --demonstrations, or make some "
            "with 'ailsrs expert' and 'ailsrs demonstrate --expert'"
        )
    return path
