"""Hopper-v5: a planar one-legged robot."""

import dataclasses

import jax
import jax.numpy as jnp

from ailsrs_jax.envs.physics import PhysicsState
from ailsrs_jax.envs.tasks.gymnasium_task import inside
from ailsrs_jax.envs.tasks.planar_walker import PlanarWalker


@dataclasses.dataclass(eq=False, kw_only=True)
class Hopper(PlanarWalker):
    """Gymnasium's ``Hopper-v5``, with its constructor flags."""

    xml_file: str = "hopper.xml"
    healthy_state_range: tuple[float, float] = (-100.0, 100.0)
    healthy_z_range: tuple[float, float] = (0.7, float("inf"))
    healthy_angle_range: tuple[float, float] = (-0.2, 0.2)

    def _healthy(self, physics_state: PhysicsState) -> jax.Array:
        # Everything but the horizontal position and the height, velocities included.
        state = jnp.concatenate([physics_state.qpos[2:], physics_state.qvel])
        return super()._healthy(physics_state) & jnp.all(inside(state, self.healthy_state_range))
