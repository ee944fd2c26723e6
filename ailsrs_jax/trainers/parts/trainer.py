"""What every algorithm is: a start, an iteration, and the scan around it."""

from abc import ABC, abstractmethod
from typing import Any

import jax


class Trainer(ABC):
    """Trains a policy; its states have ``kept`` and ``iteration``."""

    settings: Any  # the algorithm's dataclass, with num_iterations

    @abstractmethod
    def init(self, key: jax.Array) -> Any:
        """The state before the first iteration."""

    @abstractmethod
    def update(self, state: Any) -> tuple[Any, dict[str, jax.Array]]:
        """One iteration: the next state, and scalar metrics."""

    def train(self, key: jax.Array) -> tuple[Any, dict[str, jax.Array]]:
        """All iterations as one function of a key, without an early end; metrics are stacked."""
        return jax.lax.scan(
            lambda state, _: self.update(state),
            self.init(key),
            length=self.settings.num_iterations,
        )
