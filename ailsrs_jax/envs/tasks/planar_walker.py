"""What Hopper and Walker2d share: a torso that must stay up while it moves forward."""

import jax
import jax.numpy as jnp

from ailsrs_jax.envs.physics import PhysicsState
from ailsrs_jax.envs.tasks.mujoco_task import MujocoTask

MAX_OBSERVED_SPEED = 10.0  # Gymnasium clips the observed velocities [m/s, rad/s]


class PlanarWalker(MujocoTask):
    """A task whose episode ends when the torso's height or pitch leaves its healthy range."""

    def __init__(
        self,
        *,
        physics: str,
        xml_file: str,
        frame_skip: int,
        forward_reward_weight: float,
        ctrl_cost_weight: float,
        healthy_reward: float,
        terminate_when_unhealthy: bool,
        healthy_z_range: tuple[float, float],
        healthy_angle_range: tuple[float, float],
        reset_noise_scale: float,
        exclude_current_positions_from_observation: bool,
    ) -> None:
        super().__init__(
            physics=physics,
            xml_file=xml_file,
            frame_skip=frame_skip,
            reset_noise_scale=reset_noise_scale,
            num_hidden_positions=int(exclude_current_positions_from_observation),
        )
        self._forward_reward_weight = forward_reward_weight
        self._ctrl_cost_weight = ctrl_cost_weight
        self._healthy_reward = healthy_reward
        self._terminate_when_unhealthy = terminate_when_unhealthy
        self._healthy_z_range = healthy_z_range
        self._healthy_angle_range = healthy_angle_range

    def _healthy(self, physics_state: PhysicsState) -> jax.Array:
        _, height, pitch = physics_state.qpos[:3]
        return _inside(height, self._healthy_z_range) & _inside(pitch, self._healthy_angle_range)

    def _reward_terms(
        self, before: PhysicsState, after: PhysicsState, action: jax.Array
    ) -> dict[str, jax.Array]:
        velocity = self._forward_velocity(before, after)
        return {
            "reward_forward": self._forward_reward_weight * velocity,
            "reward_ctrl": -self._ctrl_cost_weight * jnp.sum(jnp.square(action)),
            "reward_survive": self._healthy_reward * self._healthy(after),
        }

    def _terminated(self, physics_state: PhysicsState) -> jax.Array:
        return self._terminate_when_unhealthy & ~self._healthy(physics_state)

    def _observation(self, physics_state: PhysicsState) -> jax.Array:
        velocities = jnp.clip(physics_state.qvel, -MAX_OBSERVED_SPEED, MAX_OBSERVED_SPEED)
        return super()._observation(physics_state.replace(qvel=velocities))

    def _positions(self, physics_state: PhysicsState) -> dict[str, jax.Array]:
        height = physics_state.qpos[1] - self._initial_qpos[1]
        return {"x_position": physics_state.qpos[0], "z_distance_from_origin": height}


def _inside(value: jax.Array, limits: tuple[float, float]) -> jax.Array:
    low, high = limits
    return (low < value) & (value < high)
