"""Hopper-v5: a planar one-legged robot."""

import jax
import jax.numpy as jnp

from ailsrs_jax.envs.physics import PhysicsState
from ailsrs_jax.envs.tasks.planar_walker import PlanarWalker


class Hopper(PlanarWalker):
    """Gymnasium's ``Hopper-v5``, with its constructor flags."""

    def __init__(
        self,
        physics: str = "auto",
        *,
        xml_file: str = "hopper.xml",
        frame_skip: int = 4,
        forward_reward_weight: float = 1.0,
        ctrl_cost_weight: float = 1e-3,
        healthy_reward: float = 1.0,
        terminate_when_unhealthy: bool = True,
        healthy_state_range: tuple[float, float] = (-100.0, 100.0),
        healthy_z_range: tuple[float, float] = (0.7, float("inf")),
        healthy_angle_range: tuple[float, float] = (-0.2, 0.2),
        reset_noise_scale: float = 5e-3,
        exclude_current_positions_from_observation: bool = True,
    ) -> None:
        super().__init__(
            physics=physics,
            xml_file=xml_file,
            frame_skip=frame_skip,
            forward_reward_weight=forward_reward_weight,
            ctrl_cost_weight=ctrl_cost_weight,
            healthy_reward=healthy_reward,
            terminate_when_unhealthy=terminate_when_unhealthy,
            healthy_z_range=healthy_z_range,
            healthy_angle_range=healthy_angle_range,
            reset_noise_scale=reset_noise_scale,
            exclude_current_positions_from_observation=exclude_current_positions_from_observation,
        )
        self._healthy_state_range = healthy_state_range

    def _healthy(self, physics_state: PhysicsState) -> jax.Array:
        # Everything but the horizontal position and the height, velocities included.
        state = jnp.concatenate([physics_state.qpos[2:], physics_state.qvel])
        low, high = self._healthy_state_range
        return super()._healthy(physics_state) & jnp.all((low < state) & (state < high))
