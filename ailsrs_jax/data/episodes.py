"""Whole episodes, as other formats hold them, and the demonstrations made of them."""

import dataclasses
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from ailsrs_jax.data.demonstrations import Demonstrations, validated
from ailsrs_jax.errors import UserError


class Episode(NamedTuple):
    """One expert episode of L steps."""

    observations: np.ndarray  # (L, n) float32
    actions: np.ndarray  # (L, p) float32
    env_return: float


@dataclasses.dataclass(frozen=True, eq=False)
class Recording:
    """Demonstrations, and what only other formats ask for."""

    demonstrations: Demonstrations
    env_rewards: np.ndarray  #: (E, T) float32, of the environment
    final_observations: np.ndarray  #: (E, n) float32, what the last action led to


def make_episode(observations: Any, actions: Any, rewards: Any, where: str) -> Episode:
    """Check one episode.

    Args:
        observations: ``(L + 1, n)``; nothing was done in the final one, which is left out.
        actions: ``(L, p)``.
        rewards: ``(L,)``.
        where: what a message begins with.

    Raises:
        UserError: they are something else.
    """
    observations, actions, rewards = map(np.asarray, (observations, actions, rewards))
    ranks = (observations.ndim, actions.ndim, rewards.ndim)
    if ranks != (2, 2, 1) or not 1 <= len(actions) == len(rewards) == len(observations) - 1:
        raise UserError(
            f"{where}: observations {observations.shape}, actions {actions.shape} and rewards "
            f"{rewards.shape} are not (L + 1, n), (L, p) and (L,)"
        )
    arrays = {"observations": observations, "actions": actions, "rewards": rewards}
    for name, array in arrays.items():
        if array.dtype.kind != "f":
            raise UserError(f"{where}: {name} are {array.dtype}, not floating-point numbers")
    with np.errstate(over="ignore"):  # too large for float32 becomes infinite, and is refused
        return Episode(
            observations[:-1].astype(np.float32),
            actions.astype(np.float32),
            float(rewards.sum(dtype=np.float64)),
        )


def stack(episodes: Sequence[Episode], num_steps: int, env_id: str, source: str) -> Demonstrations:
    """Demonstrations with a time limit of ``num_steps``, the longest episode's length or more.

    Raises:
        UserError: the episodes are of different sizes, or not finite.
    """
    sizes = sorted({(x.observations.shape[1], x.actions.shape[1]) for x in episodes})
    if len(sizes) > 1:
        raise UserError(f"{source}: the numbers of observations and actions differ: {sizes}")

    def padded(arrays: Sequence[np.ndarray]) -> np.ndarray:
        batch = np.zeros((len(arrays), num_steps, arrays[0].shape[1]), np.float32)
        for row, array in zip(batch, arrays, strict=True):
            row[: len(array)] = array
        return batch

    fields = {
        "observations": padded([episode.observations for episode in episodes]),
        "actions": padded([episode.actions for episode in episodes]),
        "lengths": np.array([len(episode.actions) for episode in episodes]),
        "returns": np.array([episode.env_return for episode in episodes]),
        "env_id": env_id,
    }
    return validated(fields, source)
