"""The base classes of Gymnasium's MuJoCo v5 tasks: their constructor flags and reward terms."""

import dataclasses
from abc import abstractmethod
from typing import ClassVar

import jax
import jax.numpy as jnp

from ailsrs_jax.envs.physics import PhysicsState, Range
from ailsrs_jax.envs.physics.base import all_within
from ailsrs_jax.envs.tasks.mujoco_task import MujocoTask

MAX_OBSERVED_SPEED = 10.0  # Gymnasium clips the observed velocities [m/s, rad/s]
# Each field of ``mjData`` that can be observed, from its first number that is: those before it
# belong to the world's body, or to the six degrees of freedom of the free joint.
OBSERVABLE = Range("cinert", 10), Range("cvel", 6), Range("qfrc_actuator", 6), Range("cfrc_ext", 6)


@dataclasses.dataclass(eq=False, kw_only=True)
class GymnasiumTask(MujocoTask):
    """A task that is rewarded for moving forward and pays for its controls.

    The fields of a task are its constructor flags, with Gymnasium's names and defaults.
    """

    NUM_HIDDEN_POSITIONS: ClassVar[int] = 1  # leading entries of qpos that can be excluded
    # Fields of ``mjData`` that the reward needs besides positions and velocities.
    _reward_readings: ClassVar[tuple[str, ...]] = ()

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
            readings=self._reward_readings,
        )

    def _reward_terms(
        self, before: PhysicsState, after: PhysicsState, action: jax.Array
    ) -> dict[str, jax.Array]:
        moved = self._forward_position(after) - self._forward_position(before)
        forward = {"reward_forward": self.forward_reward_weight * (moved / self.dt)}
        return forward | self._cost_terms(after, action)

    def _forward_position(self, physics_state: PhysicsState) -> jax.Array:
        return physics_state.qpos[0]

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


@dataclasses.dataclass(eq=False, kw_only=True)
class PlanarWalker(Walker):
    """A walker in a plane, healthy while its torso's height and pitch are within their ranges."""

    frame_skip: int = 4
    ctrl_cost_weight: float = 1e-3
    healthy_angle_range: tuple[float, float]
    reset_noise_scale: float = 5e-3

    def _healthy_ranges(self) -> tuple[Range, ...]:
        height = Range("qpos", 1, 2, *self.healthy_z_range)
        pitch = Range("qpos", 2, 3, *self.healthy_angle_range)
        return height, pitch

    def _observed(self) -> tuple[Range, ...]:
        positions, velocities = super()._observed()
        return positions, velocities._replace(low=-MAX_OBSERVED_SPEED, high=MAX_OBSERVED_SPEED)

    def _positions(self, physics_state: PhysicsState) -> dict[str, jax.Array]:
        height = physics_state.qpos[1] - self._initial_qpos[1]
        return {"x_position": physics_state.qpos[0], "z_distance_from_origin": height}


@dataclasses.dataclass(eq=False, kw_only=True)
class SpatialWalker(Walker):
    """A walker on open ground that also observes ``mjData``, and pays for forces on its bodies.

    A flag ``include_<field>_in_observation`` says whether a field is observed.
    """

    NUM_HIDDEN_POSITIONS: ClassVar[int] = 2

    frame_skip: int = 5
    contact_cost_weight: float
    include_cfrc_ext_in_observation: bool = True

    @abstractmethod
    def _contact_cost(self, physics_state: PhysicsState) -> jax.Array:
        """The cost of the forces on the bodies, ``()``."""

    def _cost_terms(self, after: PhysicsState, action: jax.Array) -> dict[str, jax.Array]:
        terms = super()._cost_terms(after, action)
        return terms | {"reward_contact": -self._contact_cost(after)}

    def _observed(self) -> tuple[Range, ...]:
        flags = {part: f"include_{part.field}_in_observation" for part in OBSERVABLE}
        readings = [part for part, flag in flags.items() if getattr(self, flag, False)]
        return *super()._observed(), *readings

    def _positions(self, physics_state: PhysicsState) -> dict[str, jax.Array]:
        x, y = physics_state.qpos[:2]
        return {"x_position": x, "y_position": y, "distance_from_origin": jnp.hypot(x, y)}
