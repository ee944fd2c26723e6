"""Demonstrations: what they are in memory, and their file."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jax
import numpy as np
from flax import struct

from ailsrs_jax.data.files import read_npz, write_atomically
from ailsrs_jax.errors import UserError

FIELDS = ("observations", "actions", "lengths", "returns", "env_id")


class Demonstrations(struct.PyTreeNode):
    """E expert episodes, recorded with a time limit of T steps.

    A length below T means that the episode ended in a terminal state; entries after an episode's
    end mean nothing.
    """

    observations: jax.Array | np.ndarray  # (E, T, n) float32
    actions: jax.Array | np.ndarray  # (E, T, p) float32, as applied
    lengths: jax.Array | np.ndarray  # (E,) int32, between 1 and T
    returns: jax.Array | np.ndarray  # (E,) float32, of the environment's reward; never trained on
    env_id: str = struct.field(pytree_node=False)

    @property
    def num_trajectories(self) -> int:
        """How many episodes there are, E."""
        return int(self.lengths.shape[0])

    @property
    def alive(self) -> jax.Array | np.ndarray:
        """``(E, T)`` bool: the step happened."""
        return np.arange(self.observations.shape[1]) < self.lengths[:, None]

    def first(self, num_trajectories: int) -> "Demonstrations":
        """The first ``num_trajectories`` episodes.

        Raises:
            UserError: there are fewer, or none is asked for.
        """
        if not 1 <= num_trajectories <= self.num_trajectories:
            raise UserError(
                f"{num_trajectories} trajectories asked for: the demonstrations hold "
                f"{self.num_trajectories}"
            )
        return jax.tree.map(lambda x: x[:num_trajectories], self)


def save_demonstrations(demonstrations: Demonstrations, path: str | Path) -> None:
    """Write a ``.npz`` file, whole or not at all."""
    arrays: dict[str, Any] = {name: np.asarray(getattr(demonstrations, name)) for name in FIELDS}
    write_atomically(path, lambda file: np.savez_compressed(file, **arrays))


def load_demonstrations(path: str | Path) -> Demonstrations:
    """Read and validate a ``.npz`` file; nothing in it is ever unpickled.

    Raises:
        UserError: the file is missing, is not such a file, or its contents contradict one another.
    """
    return validated(read_npz(Path(path), FIELDS, "demonstrations"), str(path))


def validated(fields: Mapping[str, Any], source: str) -> Demonstrations:
    """Make demonstrations of ``fields``, checked, and zero after the end of each episode.

    Raises:
        UserError: they contradict one another; the message begins with ``source``.
    """

    def require(condition: bool, problem: str) -> None:
        if not condition:
            raise UserError(f"{source}: {problem}")

    observations, actions, lengths, returns, env_id = (np.asarray(fields[name]) for name in FIELDS)
    require(observations.ndim == 3, f"observations are {observations.shape}, not (E, T, n)")
    require(actions.ndim == 3, f"actions are {actions.shape}, not (E, T, p)")
    num_episodes, num_steps = observations.shape[:2]
    require(observations.size > 0, "there are no observations")
    require(
        actions.shape[:2] == (num_episodes, num_steps) and actions.size > 0,
        f"actions {actions.shape} do not match observations {observations.shape}",
    )
    for name, array in (("lengths", lengths), ("returns", returns)):
        require(array.shape == (num_episodes,), f"{name} are {array.shape}, not ({num_episodes},)")
    require(np.issubdtype(lengths.dtype, np.integer), "lengths are not integers")
    require(
        bool(np.all((lengths >= 1) & (lengths <= num_steps))),
        f"lengths are not all between 1 and {num_steps}",
    )
    require(env_id.ndim == 0 and env_id.dtype.kind == "U", "env_id is not a single string")
    require(returns.dtype.kind in "iuf", "returns are not numbers")
    alive = (np.arange(num_steps) < lengths[:, None])[..., None]
    for name, array in (("observations", observations), ("actions", actions)):
        require(array.dtype.kind == "f", f"{name} are not floating-point numbers")
    with np.errstate(over="ignore"):  # too large for float32 becomes infinite, and is refused
        observations, actions = (
            np.where(alive, array, 0.0).astype(np.float32) for array in (observations, actions)
        )
        returns = returns.astype(np.float32)
    for name, array in zip(FIELDS, (observations, actions, lengths, returns), strict=False):
        require(bool(np.isfinite(array).all()), f"{name} hold NaN or infinity")
    return Demonstrations(observations, actions, lengths.astype(np.int32), returns, str(env_id))
