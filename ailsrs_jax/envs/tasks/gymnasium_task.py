"""The constructor flags and reward terms that Gymnasium's MuJoCo v5 tasks share."""

import dataclasses
from abc import abstractmethod
from typing import ClassVar

import jax
import jax.numpy as jnp

from ailsrs_jax.envs.physics import PhysicsState
from ailsrs_jax.envs.tasks.mujoco_task import MujocoTask


@dataclasses.dataclass(eq=False, kw_only=True)
class GymnasiumTask(MujocoTask):
    """A task that is rewarded for moving forward and pays for its controls.

    The fields of a task are its constructor flags, with Gymnasium's names and defaults.
    """

    NUM_HIDDEN_POSITIONS: ClassVar[int] = 1  # leading entries of qpos that can be excluded

    # The argument is an engine's name; the attribute of the same name is the engine itself.
    physics: dataclasses.InitVar[str] = dataclasses.field(default="auto", kw_only=False)
    xml_file: str
    frame_skip: int
    forward_reward_weight: float = 1.0
    ctrl_cost_weight: float
    reset_noise_scale: float = 0.1
    exclude_current_positions_from_observation: bool = True

    def __post_init__(self, physics: str) -> None:
        excluded = self.exclude_current_positions_from_observation
        super().__init__(
            physics=physics,
            xml_file=self.xml_file,
            frame_skip=self.frame_skip,
            reset_noise_scale=self.reset_noise_scale,
            num_hidden_positions=self.NUM_HIDDEN_POSITIONS * excluded,
            readings=self._needed_readings(),
        )

    def _needed_readings(self) -> tuple[str, ...]:
        return ()

    def _reward_terms(
        self, before: PhysicsState, after: PhysicsState, action: jax.Array
    ) -> dict[str, jax.Array]:
        velocity = self._forward_velocity(before, after)
        forward = {"reward_forward": self.forward_reward_weight * velocity}
        return forward | self._cost_terms(after, action)

    def _cost_terms(self, after: PhysicsState, action: jax.Array) -> dict[str, jax.Array]:
        del after
        return {"reward_ctrl": -self.ctrl_cost_weight * jnp.sum(jnp.square(action))}


@dataclasses.dataclass(eq=False, kw_only=True)
class Walker(GymnasiumTask):
    """A task that is also rewarded while the robot is healthy, and usually ends when it is not."""

    healthy_reward: float = 1.0
    terminate_when_unhealthy: bool = True
    healthy_z_range: tuple[float, float]

    @abstractmethod
    def _healthy(self, physics_state: PhysicsState) -> jax.Array:
        """Whether the robot is healthy, ``()`` bool."""

    def _reward_terms(
        self, before: PhysicsState, after: PhysicsState, action: jax.Array
    ) -> dict[str, jax.Array]:
        terms = super()._reward_terms(before, after, action)
        return terms | {"reward_survive": self.healthy_reward * self._healthy(after)}

    def _terminated(self, physics_state: PhysicsState) -> jax.Array:
        return self.terminate_when_unhealthy & ~self._healthy(physics_state)


def inside(value: jax.Array, limits: tuple[float, float]) -> jax.Array:
    """Whether each ``value`` is strictly between two ``limits``."""
    low, high = limits
    return (low < value) & (value < high)
