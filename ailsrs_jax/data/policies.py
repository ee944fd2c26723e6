"""Policies on disk, and as NumPy functions that drive any Gymnasium environment."""

import dataclasses
import importlib.util
from abc import ABC, abstractmethod
from collections.abc import Callable
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ailsrs_jax.data.formats.onnx import encode_onnx
from ailsrs_jax.data.formats.safetensors import encode_safetensors, read_safetensors
from ailsrs_jax.errors import UserError
from ailsrs_jax.files import read_npz, require_name, write_atomically

# The fields that any policy's file has, beside env_id; then those of a neural one.
COMMON_ARRAYS = ("mean", "std", "action_low", "action_high")
MAX_LAYERS = 16
# What the name of a policy's file ends with, and the package that it takes.
FORMATS = {".npz": "numpy", ".safetensors": "safetensors", ".onnx": "onnx"}
MLP_FIELDS = (
    *(f"{kind}_{layer}" for kind in ("weights", "biases") for layer in range(MAX_LAYERS)),
    "action_std",
)


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class SavedPolicy(ABC):
    """A policy in NumPy, linear or neural: ``policy.npz`` in memory.

    action = clip(f((observation − mean) / std), action_low, action_high), with layers
    ``h ← tanh(W h + b)`` in f, the last of them without tanh.
    """

    mean: np.ndarray  # (n,)
    std: np.ndarray  # (n,)
    action_low: np.ndarray  # (p,)
    action_high: np.ndarray  # (p,)
    env_id: str

    def __call__(
        self, observation: npt.ArrayLike, rng: np.random.Generator | None = None
    ) -> np.ndarray:
        """The action ``(p,)`` for an observation ``(n,)``, or ``(B, p)`` for a batch ``(B, n)``.

        With ``rng``, drawn at random.

        >>> import ailsrs_jax as ail
        >>> import gymnasium
        >>> policy = ail.load_expert("swimmer")
        >>> env = gymnasium.make(policy.env_id)
        >>> observation, info = env.reset(seed=0)
        >>> observation, reward, *_ = env.step(policy(observation))

        Raises:
            UserError: the observation has another size; or the policy is deterministic, and an
                action is to be drawn.
        """
        return self._act(observation, None if rng is None else rng.standard_normal)

    def predict(
        self,
        observation: Any,
        state: tuple[np.ndarray, ...] | None = None,
        episode_start: np.ndarray | None = None,  # noqa: ARG002 (the interface's)
        deterministic: bool = True,
    ) -> tuple[np.ndarray, tuple[np.ndarray, ...] | None]:
        """Actions as Stable-Baselines3's ``evaluate_policy`` asks for them, and ``state`` as it is.

        Those of a neural policy are drawn at random if not ``deterministic``, with NumPy's global
        generator, the one that Stable-Baselines3's ``set_random_seed`` seeds; a policy without
        noise has only one action.

        >>> import ailsrs_jax as ail
        >>> actions, state = ail.load_expert("swimmer").predict([[0.0] * 8] * 3)
        >>> actions.shape
        (3, 2)

        Raises:
            UserError: the observation has another size.
        """
        draws = self.is_stochastic and not deterministic
        draw = np.random.standard_normal if draws else None
        return self._act(observation, draw), state

    def _act(
        self, observation: npt.ArrayLike, draw: Callable[[tuple[int, ...]], Any] | None
    ) -> np.ndarray:
        observation = np.asarray(observation)
        if observation.shape[-1:] != self.mean.shape or observation.ndim > 2:
            raise UserError(
                f"the observation is {observation.shape}: the policy takes {self.mean.shape}, or a "
                "batch of them"
            )
        action = (observation - self.mean) / self.std
        for index, (matrix, bias) in enumerate(self.layers):
            # Transposed, which one observation does not notice and a batch needs.
            action = (matrix @ (np.tanh(action) if index else action).T).T + bias
        if draw is not None:
            action = action + self.noise_std * draw(action.shape)
        return np.clip(action, self.action_low, self.action_high)

    @property
    @abstractmethod
    def layers(self) -> tuple[tuple[np.ndarray, np.ndarray], ...]:
        """Weights ``(out, in)`` and biases ``(out,)`` of each layer; a linear policy has one."""

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

    def require_shape(self, action_size: int, observation_size: int) -> None:
        """Raise UserError unless this is a policy for so many actions and observations."""
        sizes = len(self.action_low), len(self.mean)
        if sizes != (action_size, observation_size):
            raise UserError(
                f"the policy takes {sizes[1]} observations and gives {sizes[0]} actions: the "
                f"environment has {observation_size} and {action_size}"
            )

    def save(self, path: str | Path) -> None:
        """Write a ``.npz``, ``.safetensors`` or ``.onnx`` file, whole or not at all.

        The first two hold everything, and :func:`load_policy` reads them. ONNX is for other
        programs: its input is ``observation``, float32 ``(batch, n)``, its output ``action``,
        float32 ``(batch, p)``, clipped, and the mean where actions can be drawn.

        >>> import ailsrs_jax as ail
        >>> ail.load_expert("swimmer").save("policy.onnx")

        Raises:
            UserError: the name ends otherwise, the format's package is not installed, or the place
                cannot be written to.
        """
        path, fields = Path(path), self._fields()
        require_format(path)
        if path.suffix == ".npz":
            write_atomically(path, lambda file: np.savez(file, **fields))
            return
        text = {"env_id": fields.pop("env_id")}
        if path.suffix == ".onnx":
            action_range = self.action_low, self.action_high
            content = encode_onnx(self.layers, (self.mean, self.std), action_range, text)
        else:
            content = encode_safetensors(fields, text)
        write_atomically(path, lambda file: file.write(content))

    def _fields(self) -> dict[str, Any]:
        return dataclasses.asdict(self)


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class SavedLinearPolicy(SavedPolicy):
    """action = clip(weights @ ((observation − mean) / std), action_low, action_high)."""

    weights: np.ndarray  # (p, n)

    @property
    def layers(self) -> tuple[tuple[np.ndarray, np.ndarray], ...]:
        """The weights, and biases of zero."""
        return ((self.weights, np.zeros_like(self.weights[:, 0])),)


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

    @property
    def layers(self) -> tuple[tuple[np.ndarray, np.ndarray], ...]:
        """Weights and biases of each layer."""
        return tuple(zip(self.weights, self.biases, strict=True))

    def _fields(self) -> dict[str, Any]:
        fields = super()._fields()
        for name in ("weights", "biases"):
            fields |= {f"{name}_{layer}": x for layer, x in enumerate(fields.pop(name))}
        return fields


def require_format(path: Path) -> None:
    """Raise UserError unless ``path`` is the name of a policy's file of a kind that works here."""
    if path.suffix not in FORMATS:
        raise UserError(f"{path}: the name of a policy's file ends in {', '.join(FORMATS)}")
    if importlib.util.find_spec(FORMATS[path.suffix]) is None:
        raise UserError(f"{path}: {path.suffix} files need pip install 'ailsrs_jax[export]'")


def load_policy(path: str | Path) -> SavedPolicy:
    """Read and validate a policy's ``.npz`` or ``.safetensors`` file; nothing is ever unpickled.

    >>> import ailsrs_jax as ail
    >>> ail.load_expert("swimmer").save("policy.safetensors")
    >>> ail.load_policy("policy.safetensors").env_id
    'Swimmer-v5'

    Raises:
        UserError: the file is missing, is not such a file, or its contents contradict one another.
    """
    path = Path(path)
    if path.suffix == ".onnx":
        raise UserError(f"{path}: ONNX is for other programs; here, read .npz or .safetensors")
    if path.suffix == ".safetensors":
        require_format(path)
    read = read_safetensors if path.suffix == ".safetensors" else read_npz
    fields = read(path, (*COMMON_ARRAYS, "env_id"), "a policy", ("weights", *MLP_FIELDS))
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
    """The policy file ``path`` itself, or those of a run's or an export's directory ``path``.

    Raises:
        UserError: it is a directory without any, or cannot be looked into.
    """
    try:
        names = ("policy.npz", "seed_*/policy.npz")
        found = [file for name in names for file in path.glob(name)]
        found.sort(key=lambda file: (len(file.parent.name), file.parent.name))  # 2 before 10
        paths = found if path.is_dir() else [path]
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
