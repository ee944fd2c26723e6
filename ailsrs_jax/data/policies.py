"""Policies on disk, and as NumPy functions that act in any Gymnasium environment."""

import dataclasses
from abc import ABC, abstractmethod
from collections.abc import Callable
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ailsrs_jax.data.formats.policy import Layers, read_policy, require_format
from ailsrs_jax.errors import UserError, os_errors
from ailsrs_jax.files import write_atomically

EXPERTS = ("paper", "linear")  # names of experts in the package besides the default one


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class SavedPolicy(ABC):
    """A linear or neural policy in NumPy: the content of ``policy.npz``.

    action = clip(f((observation − mean) / std), action_low, action_high), where f consists of
    layers ``h ← tanh(W h + b)``, the last one without tanh.
    """

    mean: np.ndarray  # (n,)
    std: np.ndarray  # (n,)
    action_low: np.ndarray  # (p,)
    action_high: np.ndarray  # (p,)
    env_id: str
    #: steps of an episode in the run that trained it; None for a policy from a file
    episode_length: int | None = None

    def __call__(
        self, observation: npt.ArrayLike, rng: np.random.Generator | None = None
    ) -> np.ndarray:
        """Return the action ``(p,)`` for an observation ``(n,)``, or ``(B, p)`` for ``(B, n)``.

        With ``rng`` the action is drawn at random.

        >>> import ailsrs_jax as ail
        >>> import gymnasium
        >>> policy = ail.load_expert("swimmer")
        >>> env = gymnasium.make(policy.env_id)
        >>> observation, info = env.reset(seed=0)
        >>> observation, reward, *_ = env.step(policy(observation))

        Raises:
            UserError: the observation has another size, or ``rng`` is given and the policy is
                deterministic.
        """
        return self._act(observation, None if rng is None else rng.standard_normal)

    def predict(
        self,
        observation: Any,
        state: tuple[np.ndarray, ...] | None = None,
        episode_start: np.ndarray | None = None,  # noqa: ARG002 (part of the interface)
        deterministic: bool = True,
    ) -> tuple[np.ndarray, tuple[np.ndarray, ...] | None]:
        """Return actions, and ``state`` unchanged, as Stable-Baselines3's ``evaluate_policy`` asks.

        Actions of a neural policy are drawn at random if not ``deterministic``. They are drawn from
        NumPy's global generator, which Stable-Baselines3's ``set_random_seed`` seeds.

        >>> import ailsrs_jax as ail
        >>> actions, state = ail.load_expert("swimmer").predict([[0.0] * 8] * 3)
        >>> actions.shape
        (3, 2)

        Raises:
            UserError: the observation has another size.
        """
        draws = self.is_stochastic and not deterministic
        return self._act(observation, np.random.standard_normal if draws else None), state

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
            # Transposing works for a batch and does not change a single observation.
            action = (matrix @ (np.tanh(action) if index else action).T).T + bias
        if draw is not None:
            action = action + self.noise_std * draw(action.shape)
        return np.clip(action, self.action_low, self.action_high)

    @property
    @abstractmethod
    def layers(self) -> Layers:
        """Weights ``(out, in)`` and biases ``(out,)`` of each layer; a linear policy has one."""

    @property
    def is_stochastic(self) -> bool:
        """Whether actions can be drawn at random."""
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
        """Raise UserError unless the policy takes and returns vectors of these sizes."""
        sizes = len(self.action_low), len(self.mean)
        if sizes != (action_size, observation_size):
            raise UserError(
                f"the policy takes {sizes[1]} observations and gives {sizes[0]} actions: the "
                f"environment has {observation_size} and {action_size}"
            )

    def save(self, path: str | Path) -> None:
        """Write a ``.npz``, ``.safetensors``, ``.onnx`` or ``.h`` file atomically.

        The first two hold everything, and :func:`load_policy` reads them. The others are for other
        programs. A C header has the function ``policy_act``, in float64. ONNX is in float32. Its
        input is ``observation``, ``(batch, n)``; its output is the clipped ``action``,
        ``(batch, p)``, which is the mean action of a stochastic policy.

        >>> import ailsrs_jax as ail
        >>> ail.load_expert("swimmer").save("policy.onnx")

        Raises:
            UserError: the name has another suffix, the format's package is not installed, or the
                file cannot be written.
        """
        path = Path(path)
        encode = require_format(path).encode
        write_atomically(path, encode(self._arrays(), self.layers, {"env_id": self.env_id}))

    def _arrays(self) -> dict[str, np.ndarray]:
        """The fields of the file except ``env_id``."""
        others = "env_id", "episode_length"
        return {name: array for name, array in vars(self).items() if name not in others}


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class SavedLinearPolicy(SavedPolicy):
    """action = clip(weights @ ((observation − mean) / std), action_low, action_high)."""

    weights: np.ndarray  # (p, n)

    @property
    def layers(self) -> Layers:
        """The weights, and biases of zero."""
        return ((self.weights, np.zeros_like(self.weights[:, 0])),)


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class SavedMlpPolicy(SavedPolicy):
    """A Gaussian policy whose mean is a multilayer perceptron of (observation − mean) / std.

    Each layer but the last is ``h ← tanh(W h + b)``, the last ``W h + b``.
    """

    weights: tuple[np.ndarray, ...]  # (out, in) of each layer
    biases: tuple[np.ndarray, ...]  # (out,)
    action_std: np.ndarray  # (p,) of the Gaussian

    def _action_std(self) -> np.ndarray:
        return self.action_std

    @property
    def layers(self) -> Layers:
        """Weights and biases of each layer."""
        return tuple(zip(self.weights, self.biases, strict=True))

    def _arrays(self) -> dict[str, np.ndarray]:
        arrays = super()._arrays()
        for name in ("weights", "biases"):
            arrays |= {f"{name}_{layer}": x for layer, x in enumerate(arrays.pop(name))}
        return arrays


def require_policy(policy: Any) -> None:
    """Raise UserError unless this is a :class:`SavedPolicy`."""
    if not isinstance(policy, SavedPolicy):
        raise UserError(f"this is no policy: {policy!r:.60}; load_policy reads one from a file")


def load_policy(path: str | Path) -> SavedPolicy:
    """Read and validate a policy's ``.npz`` or ``.safetensors`` file; nothing is unpickled.

    >>> import ailsrs_jax as ail
    >>> ail.load_expert("swimmer").save("policy.safetensors")
    >>> ail.load_policy("policy.safetensors").env_id
    'Swimmer-v5'

    Raises:
        UserError: the file is missing, has another format, or its contents contradict one another.
    """
    fields = read_policy(Path(path))
    return (SavedMlpPolicy if "biases" in fields else SavedLinearPolicy)(**fields)


def policy_files(path: Path) -> list[Path]:
    """Return the policy file ``path``, or those in the directory ``path`` of a run or an export.

    Raises:
        UserError: the directory holds no policy, or cannot be read.
    """
    with os_errors(f"cannot read {path}"):
        names = ("policy.npz", "seed_*/policy.npz")
        found = [file for name in names for file in path.glob(name)]
        found.sort(key=lambda file: (len(file.parent.name), file.parent.name))  # 2 before 10
        paths = found if path.is_dir() else [path]
    if not paths:
        raise UserError(f"{path} holds no seed_*/policy.npz: is it a finished run?")
    return paths


def expert_path(env_id: str, name: str | None = None) -> Path:
    """Return the file of an expert that ships with the package for ``env_id``.

    Args:
        env_id: the task.
        name: one of :data:`EXPERTS`, or None for the default expert. Where that one has the paper's
            return, it is also the one that is called ``paper``.

    Raises:
        UserError: the package has no such expert.
    """
    if name is not None and name not in EXPERTS:
        raise UserError(f"no expert is called {name!r}: the names are {' and '.join(EXPERTS)}")
    directory = Path(str(resources.files("ailsrs_jax.data"))) / "experts"
    path = directory / (f"{env_id}.npz" if name is None else f"{env_id}-{name}.npz")
    if name == "paper" and not path.is_file():
        return expert_path(env_id)
    if not path.is_file():
        kind = "" if name is None else f"{name} "
        raise UserError(
            f"no {kind}expert of {env_id} ships with the package: use --demonstrations, or make "
            "some with 'ailsrs expert' and 'ailsrs demonstrate --expert'"
        )
    return path
