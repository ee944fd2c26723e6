"""Whole episodes, which other libraries' formats hold."""

from typing import Any, NamedTuple

import numpy as np

from ailsrs_jax.errors import UserError


class Episode(NamedTuple):
    """One expert episode of L steps."""

    observations: np.ndarray  # (L + 1, n) float32, with the final one
    actions: np.ndarray  # (L, p) float32
    rewards: np.ndarray  # (L,), of the environment

    @property
    def length(self) -> int:
        """The number of steps, L."""
        return len(self.actions)


def make_episode(observations: Any, actions: Any, rewards: Any, where: str) -> Episode:
    """Check and return one episode; an error message begins with ``where``.

    Raises:
        UserError: they have other shapes, or are not floating-point numbers.
    """
    observations, actions, rewards = map(np.asarray, (observations, actions, rewards))
    ranks = (observations.ndim, actions.ndim, rewards.ndim)
    if ranks != (2, 2, 1) or not 1 <= len(actions) == len(rewards) == len(observations) - 1:
        raise UserError(
            f"{where}: observations {observations.shape}, actions {actions.shape} and rewards "
            f"{rewards.shape} are not (L + 1, n), (L, p) and (L,)"
        )
    for name, array in zip(Episode._fields, (observations, actions, rewards)):
        if array.dtype.kind != "f":
            raise UserError(f"{where}: {name} are {array.dtype}, not floating-point numbers")
    with np.errstate(over="ignore"):  # too large for float32 becomes infinite, and is refused later
        return Episode(observations.astype(np.float32), actions.astype(np.float32), rewards)
