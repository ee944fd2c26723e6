"""What Ant and Humanoid share: a robot on open ground that feels the forces on its bodies."""

from abc import abstractmethod
from collections.abc import Sequence

import jax
import jax.numpy as jnp
import mujoco

from ailsrs_jax.envs.physics import PhysicsState
from ailsrs_jax.envs.tasks.mujoco_task import MujocoTask

# Where each observed reading starts: after the world's body, or the six dofs of the free joint.
FIRST_ROW = {"cinert": 1, "cvel": 1, "qfrc_actuator": 6, "cfrc_ext": 1}


class SpatialWalker(MujocoTask):
    """A task that also observes fields of ``mjData``, and pays for the forces on its bodies.

    The episode ends when the robot is not healthy.
    """

    def __init__(
        self,
        *,
        physics: str,
        xml_file: str,
        frame_skip: int,
        forward_reward_weight: float,
        ctrl_cost_weight: float,
        contact_cost_weight: float,
        healthy_reward: float,
        terminate_when_unhealthy: bool,
        healthy_z_range: tuple[float, float],
        reset_noise_scale: float,
        exclude_current_positions_from_observation: bool,
        position_reading: str,
        observed_readings: Sequence[str],
    ) -> None:
        super().__init__(
            physics=physics,
            xml_file=xml_file,
            frame_skip=frame_skip,
            reset_noise_scale=reset_noise_scale,
            num_hidden_positions=2 * exclude_current_positions_from_observation,
            readings=tuple(dict.fromkeys([position_reading, "cfrc_ext", *observed_readings])),
        )
        self._forward_reward_weight = forward_reward_weight
        self._ctrl_cost_weight = ctrl_cost_weight
        self._contact_cost_weight = contact_cost_weight
        self._healthy_reward = healthy_reward
        self._terminate_when_unhealthy = terminate_when_unhealthy
        self._healthy_z_range = healthy_z_range
        self._observed_readings = observed_readings

    @property
    def observation_size(self) -> int:
        """Length n of an observation."""
        data = mujoco.MjData(self.physics.model)
        readings = [getattr(data, name)[FIRST_ROW[name] :] for name in self._observed_readings]
        return super().observation_size + sum(reading.size for reading in readings)

    @abstractmethod
    def _healthy(self, physics_state: PhysicsState) -> jax.Array:
        """Whether the robot stands, ``()`` bool."""

    @abstractmethod
    def _contact_cost(self, physics_state: PhysicsState) -> jax.Array:
        """What the forces on the bodies cost."""

    def _reward_terms(
        self, before: PhysicsState, after: PhysicsState, action: jax.Array
    ) -> dict[str, jax.Array]:
        velocity = self._forward_velocity(before, after)
        return {
            "reward_forward": self._forward_reward_weight * velocity,
            "reward_ctrl": -self._ctrl_cost_weight * jnp.sum(jnp.square(action)),
            "reward_contact": -self._contact_cost(after),
            "reward_survive": self._healthy_reward * self._healthy(after),
        }

    def _terminated(self, physics_state: PhysicsState) -> jax.Array:
        return self._terminate_when_unhealthy & ~self._healthy(physics_state)

    def _observation(self, physics_state: PhysicsState) -> jax.Array:
        readings = [
            physics_state.readings[name][FIRST_ROW[name] :].ravel()
            for name in self._observed_readings
        ]
        return jnp.concatenate([super()._observation(physics_state), *readings])

    def _positions(self, physics_state: PhysicsState) -> dict[str, jax.Array]:
        x, y = physics_state.qpos[:2]
        return {"x_position": x, "y_position": y, "distance_from_origin": jnp.hypot(x, y)}
