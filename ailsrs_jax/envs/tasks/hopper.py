"""Hopper-v5: a planar one-legged robot."""

import dataclasses

from ailsrs_jax.envs.physics import Range
from ailsrs_jax.envs.tasks.gymnasium_task import PlanarWalker


@dataclasses.dataclass(eq=False, kw_only=True)
class Hopper(PlanarWalker):
    """Gymnasium's ``Hopper-v5``, with its constructor flags."""

    xml_file: str = "hopper.xml"
    healthy_state_range: tuple[float, float] = (-100.0, 100.0)
    healthy_z_range: tuple[float, float] = (0.7, float("inf"))
    healthy_angle_range: tuple[float, float] = (-0.2, 0.2)

    def _healthy_ranges(self) -> tuple[Range, ...]:
        # Everything but the horizontal position and the height, velocities included.
        low, high = self.healthy_state_range
        state = Range("qpos", 2, low=low, high=high), Range("qvel", low=low, high=high)
        return *super()._healthy_ranges(), *state
