"""The two types that every algorithm has: its trainer, and its record."""

import dataclasses
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from typing import Any

import jax

from ailsrs_jax.errors import UserError
from ailsrs_jax.trainers.parts.episodes import Episodes
from ailsrs_jax.trainers.parts.rollout import Simulator
from ailsrs_jax.trainers.parts.settings import override

Metrics = dict[str, jax.Array]
ANY_TASK = ""  # in a preset, changes for every task


class Trainer(ABC):
    """Trains a policy; its states have the fields ``kept`` and ``iteration``."""

    simulator: Simulator
    settings: Any  # the algorithm's dataclass, with num_iterations and episode_length

    @property
    def env(self) -> Any:
        """The environment."""
        return self.simulator.env

    @abstractmethod
    def init(self, key: jax.Array) -> Any:
        """Return the state before the first iteration."""

    @abstractmethod
    def update(self, state: Any) -> tuple[Any, Metrics]:
        """Run one iteration; return the next state, and scalar metrics."""

    def evaluate(self, policy: Any, key: jax.Array) -> tuple[Episodes, Metrics]:
        """Simulate the evaluation of an iteration; return the episodes, and their metrics."""
        episodes = self.simulator.evaluate(
            policy, key, self.settings.num_evaluation_episodes, self.settings.episode_length
        )
        return episodes, episodes.evaluated()

    def train(self, key: jax.Array) -> tuple[Any, Metrics]:
        """Run all iterations as one function of a key, without an early end; stack the metrics."""
        place = self.simulator.place
        return jax.lax.scan(
            lambda state, _: place(self.update(state)),
            place(self.init(key)),
            length=self.settings.num_iterations,
        )


@dataclasses.dataclass(frozen=True)
class Algorithm:
    """Everything that the rest of the package asks about a way to train a policy."""

    title: str  #: for people
    #: ``make(simulator, demonstrations, settings)`` checks its arguments and returns the trainer;
    #: an algorithm that does not imitate gets None for the demonstrations
    make: Callable[..., Trainer]
    settings: type  #: a dataclass whose defaults are valid
    #: changes to the defaults by preset and task; those for every task have the key ``""``
    presets: Mapping[str, Mapping[str, Mapping[str, Any]]]
    imitates: bool = True  #: learns from demonstrations, not from the environment's reward
    shares_devices: bool = False  #: several devices can share the episodes of an iteration
    #: the metric that decides which policy is kept: the largest return, or the smallest of another
    kept_by: str = "expert_distance"

    def preset(self, env_id: str, preset: str) -> Any:
        """Return the settings of ``preset`` for the task ``env_id``.

        Raises:
            UserError: there is no such preset.
        """
        if preset not in self.presets:
            raise UserError(f"unknown preset '{preset}': use {' or '.join(self.presets)}")
        tasks = self.presets[preset]
        return override(self.settings(), {**tasks[ANY_TASK], **tasks.get(env_id, {})})
