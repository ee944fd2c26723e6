"""Ant-v5: a four-legged robot."""

import dataclasses
from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np

from ailsrs_jax.envs.physics import PhysicsState, Range
from ailsrs_jax.envs.tasks.gymnasium_task import SpatialWalker
from ailsrs_jax.errors import UserError


@dataclasses.dataclass(eq=False, kw_only=True)
class Ant(SpatialWalker):
    """Gymnasium's ``Ant-v5``, with its constructor flags."""

    _reward_readings: ClassVar[tuple[str, ...]] = ("xpos", "cfrc_ext")

    xml_file: str = "ant.xml"
    ctrl_cost_weight: float = 0.5
    contact_cost_weight: float = 5e-4
    main_body: int | str = 1
    healthy_z_range: tuple[float, float] = (0.2, 1.0)
    contact_force_range: tuple[float, float] = (-1.0, 1.0)

    def __post_init__(self, physics: str) -> None:
        super().__post_init__(physics)
        try:
            self._main_body = self.physics.model.body(self.main_body).id
        except (KeyError, IndexError) as error:
            raise UserError(f"Ant-v5: {self.xml_file} has no body {self.main_body!r}") from error

    def _forward_position(self, physics_state: PhysicsState) -> jax.Array:
        return physics_state.readings["xpos"][self._main_body, 0]

    def _healthy_ranges(self) -> tuple[Range, ...]:
        # The limits themselves are healthy. All numbers must be finite.
        low, high = np.array(self.healthy_z_range, np.float32)
        height = Range("qpos", 2, 3, np.nextafter(low, -np.inf), np.nextafter(high, np.inf))
        return height, Range("qpos"), Range("qvel")

    def _contact_cost(self, physics_state: PhysicsState) -> jax.Array:
        forces = jnp.clip(physics_state.readings["cfrc_ext"], *self.contact_force_range)
        return self.contact_cost_weight * jnp.sum(jnp.square(forces))

    def _initial_velocity(self, key: jax.Array) -> jax.Array:
        return self._normal_velocity(key)

    def _observed(self) -> tuple[Range, ...]:
        low, high = self.contact_force_range
        parts = super()._observed()
        return tuple(p._replace(low=low, high=high) if p.field == "cfrc_ext" else p for p in parts)
