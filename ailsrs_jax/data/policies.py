"""Policies on disk, and as NumPy functions that drive any Gymnasium environment."""

import dataclasses
from abc import ABC, abstractmethod
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from ailsrs_jax.data.files import read_npz, require_name, write_atomically
from ailsrs_jax.errors import UserError

# The fields that any policy's file has, beside env_id; then those of a neural one.
COMMON_ARRAYS = ("mean", "std", "action_low", "action_high")
MAX_LAYERS = 16
MLP_FIELDS = (
    *(f"{kind}_{layer}" for kind in ("weights", "biases") for layer in range(MAX_LAYERS)),
    "action_std",
)


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class SavedPolicy(ABC):
    """``policy.npz``: what linear and neural policies have in common."""

    mean: np.ndarray  # (n,)
    std: np.ndarray  # (n,)
    action_low: np.ndarray  # (p,)
    action_high: np.ndarray  # (p,)
    env_id: str

    def __call__(
        self, observation: np.ndarray, rng: np.random.Generator | None = None
    ) -> np.ndarray:
        """The action ``(p,)`` for one observation ``(n,)``; with ``rng``, drawn at random.

        Raises:
            UserError: the policy is deterministic, and an action is to be drawn.
        """
        action = self._unclipped((observation - self.mean) / self.std)
        if rng is not None:
            action = action + self.noise_std * rng.standard_normal(len(self.noise_std))
        return np.clip(action, self.action_low, self.action_high)

    @property
    def is_stochastic(self) -> bool:
        """Whether its actions can be drawn at random."""
        return bool(self._action_std().any())

    @property
    def noise_std(self) -> np.ndarray:
        """Standard deviation ``(p,)`` of the actions.

        Raises:
            UserError: the policy is deterministic.
        """
        if not self.is_stochastic:
            raise UserError("the policy is deterministic: there are no actions to draw")
        return self._action_std()

    def _action_std(self) -> np.ndarray:
        return np.zeros(len(self.action_low))

    @abstractmethod
    def _unclipped(self, standardized: np.ndarray) -> np.ndarray:
        """The action ``(p,)`` before it is clipped, for a standardised observation ``(n,)``."""

    def require_shape(self, action_size: int, observation_size: int) -> None:
        """Raise UserError unless this is a policy for so many actions and observations."""
        sizes = len(self.action_low), len(self.mean)
        if sizes != (action_size, observation_size):
            raise UserError(
                f"the policy takes {sizes[1]} observations and gives {sizes[0]} actions: the "
                f"environment has {observation_size} and {action_size}"
            )

    def save(self, path: str | Path) -> None:
        """Write a ``.npz`` file, whole or not at all."""
        fields = self._fields()
        write_atomically(path, lambda file: np.savez(file, **fields))

    def _fields(self) -> dict[str, Any]:
        return dataclasses.asdict(self)


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class SavedLinearPolicy(SavedPolicy):
    """action = clip(weights @ ((observation − mean) / std), low, high)."""

    weights: np.ndarray  # (p, n)

    def _unclipped(self, standardized: np.ndarray) -> np.ndarray:
        action: np.ndarray = self.weights @ standardized
        return action


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class SavedMlpPolicy(SavedPolicy):
    """A multilayer perceptron of (observation − mean) / std, the mean of a Gaussian policy.

    Each layer but the last is ``h ← tanh(W h + b)``, the last ``W h + b``.
    """

    weights: tuple[np.ndarray, ...]  # (out, in) of each layer
    biases: tuple[np.ndarray, ...]  # (out,)
    action_std: np.ndarray  # (p,) of the Gaussian

    def _action_std(self) -> np.ndarray:
        return self.action_std

    def _unclipped(self, standardized: np.ndarray) -> np.ndarray:
        hidden = standardized
        for layer, (matrix, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            hidden = matrix @ (np.tanh(hidden) if layer else hidden) + bias
        return hidden

    def _fields(self) -> dict[str, Any]:
        fields = super()._fields()
        for name in ("weights", "biases"):
            fields |= {f"{name}_{layer}": x for layer, x in enumerate(fields.pop(name))}
        return fields


def load_policy(path: str | Path) -> SavedPolicy:
    """Read and validate ``policy.npz``.

    Raises:
        UserError: the file is missing, is not such a file, or its contents contradict one another.
    """
    path = Path(path)
    fields = read_npz(path, (*COMMON_ARRAYS, "env_id"), "a policy", ("weights", *MLP_FIELDS))
    is_linear = "weights" in fields
    num_layers = 1 if is_linear else sum(name.startswith("weights_") for name in fields)
    needed = [f"{kind}_{layer}" for kind in ("weights", "biases") for layer in range(num_layers)]
    needed = ["weights"] if is_linear else [*needed, "action_std"]
    missing = [name for name in needed if name not in fields]
    if missing or num_layers == 0:
        raise UserError(f"{path} has no {', '.join(missing) or 'weights'}: not a file of a policy")

    def require(condition: bool, problem: str) -> None:
        if not condition:
            raise UserError(f"{path}: {problem}")

    env_id = fields.pop("env_id")
    require(env_id.ndim == 0 and env_id.dtype.kind == "U", "env_id is not a single string")
    require_name(str(env_id), str(path))
    layers = [fields["weights" if is_linear else f"weights_{i}"] for i in range(num_layers)]
    shapes: dict[str, tuple[int, ...]] = {}
    for layer, matrix in enumerate(layers):
        require(matrix.ndim == 2, f"weights are {matrix.shape}, not (out, in)")
        require(matrix.size > 0, f"weights are {matrix.shape}: there is nothing in them")
        before = layers[layer - 1].shape if layer else matrix.shape[1:]
        require(
            before[:1] == matrix.shape[1:],
            f"layers {layer - 1} and {layer} are {before} and {matrix.shape}: they do not fit",
        )
        shapes[f"biases_{layer}"] = matrix.shape[:1]
    shapes |= dict.fromkeys(("mean", "std"), layers[0].shape[1:])
    shapes |= dict.fromkeys(("action_low", "action_high", "action_std"), layers[-1].shape[:1])
    for name, array in fields.items():
        shape = shapes.get(name, array.shape)
        require(array.shape == shape, f"{name} is {array.shape}, not {shape}")
        require(
            array.dtype in (np.float32, np.float64) and bool(np.isfinite(array).all()),
            f"{name} is not made of finite floating-point numbers",
        )
    require(bool((fields["std"] > 0).all()), "std is not positive")
    common: dict[str, Any] = {name: fields[name] for name in COMMON_ARRAYS}
    common["env_id"] = str(env_id)
    if is_linear:
        return SavedLinearPolicy(**common, weights=fields["weights"])
    return SavedMlpPolicy(
        **common,
        weights=tuple(layers),
        biases=tuple(fields[f"biases_{layer}"] for layer in range(num_layers)),
        action_std=fields["action_std"],
    )


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


def expert_path(env_id: str, *, of_paper: bool = False) -> Path:
    """The file of the expert that ships with the package for ``env_id``.

    With ``of_paper``, the one whose return is that of the paper's, where it is another one.

    Raises:
        UserError: none ships for this task.
    """
    directory = Path(str(resources.files("ailsrs_jax.data"))) / "experts"
    path, weaker = directory / f"{env_id}.npz", directory / f"{env_id}-paper.npz"
    if of_paper and weaker.is_file():
        return weaker
    if not path.is_file():
        raise UserError(
            f"no expert of {env_id} ships with the package: use --demonstrations, or make some "
            "with 'ailsrs expert' and 'ailsrs demonstrate --expert'"
        )
    return path
