"""The constructor flags and reward terms that Gymnasium's MuJoCo v5 tasks share."""

import dataclasses
from abc import abstractmethod
from typing import ClassVar

import jax
import jax.numpy as jnp

from ailsrs_jax.envs.physics import PhysicsState, Range
from ailsrs_jax.envs.physics.base import all_within
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
            readings=self._reward_readings(),
        )

    def _reward_readings(self) -> tuple[str, ...]:
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
    def _healthy_ranges(self) -> tuple[Range, ...]:
        """The robot is healthy while all of these numbers are strictly within their limits."""

    def _limits(self) -> tuple[Range, ...]:
        return self._healthy_ranges() if self.terminate_when_unhealthy else ()

    def _reward_terms(
        self, before: PhysicsState, after: PhysicsState, action: jax.Array
    ) -> dict[str, jax.Array]:
        terms = super()._reward_terms(before, after, action)
        healthy = all_within(after, self._healthy_ranges())
        return terms | {"reward_survive": self.healthy_reward * healthy}
