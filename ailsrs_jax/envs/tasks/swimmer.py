"""Swimmer-v5: a planar three-link snake in a viscous fluid."""

import dataclasses
from typing import ClassVar

import jax

from ailsrs_jax.envs.physics import PhysicsState
from ailsrs_jax.envs.tasks.gymnasium_task import GymnasiumTask


@dataclasses.dataclass(eq=False, kw_only=True)
class Swimmer(GymnasiumTask):
    """Gymnasium's ``Swimmer-v5``, with its constructor flags."""

    NUM_HIDDEN_POSITIONS: ClassVar[int] = 2

    xml_file: str = "swimmer.xml"
    frame_skip: int = 4
    ctrl_cost_weight: float = 1e-4

    def _positions(self, physics_state: PhysicsState) -> dict[str, jax.Array]:
        return {"x_position": physics_state.qpos[0], "y_position": physics_state.qpos[1]}
