"""Demonstrations in memory, and their file."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jax
import numpy as np
from flax import struct

from ailsrs_jax.data.formats.npz import encode_npz, read_npz
from ailsrs_jax.errors import UserError, requirement
from ailsrs_jax.files import require_name, write_atomically

REQUIRED = ("observations", "lengths", "returns", "env_id")
OPTIONAL = ("actions", "stride")


class Demonstrations(struct.PyTreeNode):
    """E expert episodes, recorded with a time limit of T entries.

    An episode with a length below T ended in a terminal state. Entries after an episode's end are
    meaningless. Demonstrations without actions serve imitation from observations alone.
    """

    observations: jax.Array | np.ndarray  #: (E, T, n) float32
    actions: jax.Array | np.ndarray | None  #: (E, T, p) float32, as applied
    lengths: jax.Array | np.ndarray  #: (E,) int32, entries of each episode, between 1 and T
    returns: jax.Array | np.ndarray  #: (E,) float32, of the environment's reward; not trained on
    env_id: str = struct.field(pytree_node=False)
    stride: int = struct.field(pytree_node=False, default=1)  #: environment steps between entries

    @property
    def num_trajectories(self) -> int:
        """The number of episodes, E."""
        return int(self.lengths.shape[0])

    @property
    def time_limit(self) -> int:
        """The time limit in environment steps; below it if entries at the end were left out."""
        return int(self.observations.shape[1]) * self.stride

    @property
    def alive(self) -> jax.Array | np.ndarray:
        """Whether each entry belongs to its episode, ``(E, T)`` bool."""
        return np.arange(self.observations.shape[1]) < self.lengths[:, None]

    def first(self, num_trajectories: int) -> "Demonstrations":
        """Return the first ``num_trajectories`` episodes.

        Raises:
            UserError: the number is below 1, or there are fewer episodes.
        """
        if not 1 <= num_trajectories <= self.num_trajectories:
            raise UserError(
                f"cannot use {num_trajectories} trajectories: the demonstrations hold "
                f"{self.num_trajectories}"
            )
        return jax.tree.map(lambda x: x[:num_trajectories], self)

    def subsample(self, every: int, seed: int = 0) -> "Demonstrations":
        """Keep every k-th entry of each episode, beginning with a random one of its first k.

        The time limit becomes ⌊T / k⌋, the number of whole blocks of k entries. An episode that
        reaches it keeps one entry of each block whatever its offset, so a length below the time
        limit still means that the episode ended. An episode of L entries keeps L / k on average,
        except that one shorter than k keeps one entry, drawn from all of them.

        Args:
            every: k.
            seed: seed of the offsets, which are drawn for one episode after another.

        Raises:
            UserError: k is below 1 or above the time limit.
        """
        num_blocks = self.observations.shape[1] // max(every, 1)
        if every < 1 or num_blocks < 1:
            raise UserError(
                f"cannot keep every {every}th step: the number must be from 1 to the time limit of "
                f"the demonstrations, {self.observations.shape[1]}"
            )
        lengths = np.asarray(self.lengths)
        offsets = np.random.default_rng(seed).integers(np.minimum(every, lengths))
        kept = np.minimum(-(-(lengths - offsets) // every), num_blocks).astype(np.int32)
        times = offsets[:, None] + every * np.arange(num_blocks)
        # Entries past the episode's end are meaningless, so index 0 is a safe placeholder.
        times = np.where(np.arange(num_blocks) < kept[:, None], times, 0)

        def entries(array: jax.Array | np.ndarray) -> np.ndarray:
            return np.take_along_axis(np.asarray(array), times[..., None], axis=1)

        return self.replace(
            observations=entries(self.observations),
            actions=None if self.actions is None else entries(self.actions),
            lengths=kept,
            stride=self.stride * every,
        )

    def fields(self) -> dict[str, np.ndarray]:
        """Return the arrays of their file, without actions if there are none or a stride of 1."""
        absent = {"actions": self.actions is None, "stride": self.stride == 1}
        return {name: np.asarray(x) for name, x in vars(self).items() if not absent.get(name)}


def save_demonstrations(demonstrations: Demonstrations, path: str | Path) -> None:
    """Write a ``.npz`` file atomically; :func:`load_demonstrations` reads it."""
    write_atomically(path, encode_npz(demonstrations.fields(), compress=True))


def load_demonstrations(path: str | Path) -> Demonstrations:
    """Read and validate a ``.npz`` file; nothing is unpickled.

    Raises:
        UserError: the file is missing, has another format, or its contents contradict one another.
    """
    return validated(read_npz(Path(path), REQUIRED, "demonstrations", OPTIONAL), str(path))


def validated(fields: Mapping[str, Any], source: str) -> Demonstrations:
    """Check ``fields`` and return them as demonstrations, with zeros after the episodes' ends.

    Raises:
        UserError: they contradict one another; the message begins with ``source``.
    """
    require = requirement(source)
    observations, lengths, returns, env_id = (np.asarray(fields[name]) for name in REQUIRED)
    actions, stride = fields.get("actions"), np.asarray(fields.get("stride", 1))
    require(observations.ndim == 3, f"observations are {observations.shape}, not (E, T, n)")
    require(observations.size > 0, "there are no observations")
    num_episodes, num_steps = observations.shape[:2]
    steps = {"observations": observations}
    if actions is not None:
        actions = steps["actions"] = np.asarray(actions)
        require(actions.ndim == 3, f"actions are {actions.shape}, not (E, T, p)")
        require(
            actions.shape[:2] == observations.shape[:2] and actions.size > 0,
            f"actions {actions.shape} do not match observations {observations.shape}",
        )
    for name, array in (("lengths", lengths), ("returns", returns)):
        require(array.shape == (num_episodes,), f"{name} are {array.shape}, not ({num_episodes},)")
    require(lengths.dtype.kind in "iu", "lengths are not integers")
    in_range = (lengths >= 1) & (lengths <= num_steps)
    require(bool(in_range.all()), f"lengths are not all between 1 and {num_steps}")
    require(env_id.ndim == 0 and env_id.dtype.kind == "U", "env_id is not a single string")
    require_name(str(env_id), source)
    require(
        stride.ndim == 0 and stride.dtype.kind in "iu" and int(stride) >= 1,
        "stride is not a single positive integer",
    )
    require(returns.dtype.kind in "iuf", "returns are not numbers")
    for name, array in steps.items():
        require(array.dtype.kind == "f", f"{name} are not floating-point numbers")
    # The types come first: an array of empty strings can have a huge shape in a tiny file.
    alive = (np.arange(num_steps) < lengths[:, None])[..., None]
    numbers = {name: np.where(alive, array, 0.0) for name, array in steps.items()}
    numbers["returns"] = returns
    with np.errstate(over="ignore"):  # too large for float32 becomes infinite, and is refused
        floats = {name: x.astype(np.float32) for name, x in numbers.items()}
    for name, array in floats.items():
        require(bool(np.isfinite(array).all()), f"{name} hold NaN or infinity")
    return Demonstrations(
        observations=floats["observations"],
        actions=floats.get("actions"),
        returns=floats["returns"],
        lengths=lengths.astype(np.int32),
        env_id=str(env_id),
        stride=int(stride),
    )
