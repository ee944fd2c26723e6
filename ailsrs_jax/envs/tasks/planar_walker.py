"""Hopper's and Walker2d's base class: a torso that moves in a plane and must stay upright."""

import dataclasses

import jax

from ailsrs_jax.envs.physics import PhysicsState, Range
from ailsrs_jax.envs.tasks.gymnasium_task import Walker

MAX_OBSERVED_SPEED = 10.0  # Gymnasium clips the observed velocities [m/s, rad/s]


@dataclasses.dataclass(eq=False, kw_only=True)
class PlanarWalker(Walker):
    """A walker that is healthy while its torso's height and pitch are within their ranges."""

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
