"""Demonstrations: what they are in memory, and their file."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jax
import numpy as np
from flax import struct

from ailsrs_jax.errors import UserError
from ailsrs_jax.files import read_npz, require_name, write_atomically

REQUIRED = ("observations", "lengths", "returns", "env_id")
OPTIONAL = ("actions", "stride")


class Demonstrations(struct.PyTreeNode):
    """E expert episodes, recorded with a time limit of T entries.

    A length below T means that the episode ended in a terminal state; entries after an episode's
    end mean nothing. Without actions they are for imitation from observations alone.
    """

    observations: jax.Array | np.ndarray  #: (E, T, n) float32
    actions: jax.Array | np.ndarray | None  #: (E, T, p) float32, as applied
    lengths: jax.Array | np.ndarray  #: (E,) int32, entries of each episode, between 1 and T
    returns: jax.Array | np.ndarray  #: (E,) float32, of the environment's reward; never trained on
    env_id: str = struct.field(pytree_node=False)
    stride: int = struct.field(pytree_node=False, default=1)  #: environment steps between entries

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

    def subsample(self, every: int, seed: int = 0) -> "Demonstrations":
        """Keep every k-th entry of each episode, from a random one of its first k on.

        The time limit becomes ⌊T / k⌋ whole blocks of k entries. An episode that reaches it keeps
        one entry of each block, wherever it begins, so that a length below it still means that the
        episode ended; one of L entries keeps L / k of them on average. Only an episode shorter than
        k keeps more than its share: one entry, drawn from all of its own.

        Args:
            every: k.
            seed: of the offsets, which are drawn one episode after the other.

        Raises:
            UserError: k is below 1 or above the time limit.
        """
        num_blocks = self.observations.shape[1] // max(every, 1)
        if every < 1 or num_blocks < 1:
            raise UserError(
                f"every {every}th step asked for: it must be from 1 to the time limit of the "
                f"demonstrations, {self.observations.shape[1]}"
            )
        lengths = np.asarray(self.lengths)
        offsets = np.random.default_rng(seed).integers(np.minimum(every, lengths))
        kept = np.minimum(-(-(lengths - offsets) // every), num_blocks).astype(np.int32)
        times = offsets[:, None] + every * np.arange(num_blocks)
        # Past the episode's end any entry will do.
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
        """What their file holds; actions and stride are left out where there are none."""
        present = ["observations", "actions", "lengths", "returns", "env_id", "stride"]
        if self.actions is None:
            present.remove("actions")
        if self.stride == 1:
            present.remove("stride")
        return {name: np.asarray(getattr(self, name)) for name in present}


def save_demonstrations(demonstrations: Demonstrations, path: str | Path) -> None:
    """Write a ``.npz`` file, whole or not at all; :func:`load_demonstrations` reads it."""
    fields: dict[str, Any] = demonstrations.fields()
    write_atomically(path, lambda file: np.savez_compressed(file, **fields))


def load_demonstrations(path: str | Path) -> Demonstrations:
    """Read and validate a ``.npz`` file; nothing in it is ever unpickled.

    Raises:
        UserError: the file is missing, is not such a file, or its contents contradict one another.
    """
    return validated(read_npz(Path(path), REQUIRED, "demonstrations", OPTIONAL), str(path))


def validated(fields: Mapping[str, Any], source: str) -> Demonstrations:
    """Make demonstrations of ``fields``, checked, and zero after the end of each episode.

    Raises:
        UserError: they contradict one another; the message begins with ``source``.
    """

    def require(condition: bool, problem: str) -> None:
        if not condition:
            raise UserError(f"{source}: {problem}")

    observations, lengths, returns, env_id = (np.asarray(fields[name]) for name in REQUIRED)
    require(observations.ndim == 3, f"observations are {observations.shape}, not (E, T, n)")
    num_episodes, num_steps = observations.shape[:2]
    require(observations.size > 0, "there are no observations")
    steps = {"observations": observations}
    if fields.get("actions") is not None:
        actions = np.asarray(fields["actions"])
        require(actions.ndim == 3, f"actions are {actions.shape}, not (E, T, p)")
        require(
            actions.shape[:2] == (num_episodes, num_steps) and actions.size > 0,
            f"actions {actions.shape} do not match observations {observations.shape}",
        )
        steps["actions"] = actions
    for name, array in (("lengths", lengths), ("returns", returns)):
        require(array.shape == (num_episodes,), f"{name} are {array.shape}, not ({num_episodes},)")
    require(np.issubdtype(lengths.dtype, np.integer), "lengths are not integers")
    require(
        bool(np.all((lengths >= 1) & (lengths <= num_steps))),
        f"lengths are not all between 1 and {num_steps}",
    )
    require(env_id.ndim == 0 and env_id.dtype.kind == "U", "env_id is not a single string")
    require_name(str(env_id), source)
    stride = np.asarray(fields.get("stride", 1))
    require(
        stride.ndim == 0 and np.issubdtype(stride.dtype, np.integer) and int(stride) >= 1,
        "stride is not a single integer from 1 on",
    )
    require(returns.dtype.kind in "iuf", "returns are not numbers")
    for name, array in steps.items():
        require(array.dtype.kind == "f", f"{name} are not floating-point numbers")
    # From here on there are as many numbers in memory as the shapes say.
    alive = (np.arange(num_steps) < lengths[:, None])[..., None]
    with np.errstate(over="ignore"):  # too large for float32 becomes infinite, and is refused
        steps = {
            name: np.where(alive, array, 0.0).astype(np.float32) for name, array in steps.items()
        }
        returns = returns.astype(np.float32)
    for name, array in (*steps.items(), ("returns", returns)):
        require(bool(np.isfinite(array).all()), f"{name} hold NaN or infinity")
    return Demonstrations(
        observations=steps["observations"],
        actions=steps.get("actions"),
        lengths=lengths.astype(np.int32),
        returns=returns,
        env_id=str(env_id),
        stride=int(stride),
    )
