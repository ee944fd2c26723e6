"""Ant's and Humanoid's base class: a robot on open ground that feels the forces on its bodies."""

import dataclasses
from abc import abstractmethod
from typing import ClassVar

import jax
import jax.numpy as jnp

from ailsrs_jax.envs.physics import PhysicsState, Range
from ailsrs_jax.envs.tasks.gymnasium_task import Walker

# Each field of ``mjData`` that can be observed, from its first number that is: those before it
# belong to the world's body, or to the six degrees of freedom of the free joint.
OBSERVABLE = (
    Range("cinert", 10),
    Range("cvel", 6),
    Range("qfrc_actuator", 6),
    Range("cfrc_ext", 6),
)


@dataclasses.dataclass(eq=False, kw_only=True)
class SpatialWalker(Walker):
    """A walker that also observes fields of ``mjData`` and pays for the forces on its bodies.

    A flag ``include_<field>_in_observation`` says whether a field is observed.
    """

    NUM_HIDDEN_POSITIONS: ClassVar[int] = 2
    POSITION_READING: ClassVar[str]  # the field of ``mjData`` that gives the forward position

    frame_skip: int = 5
    contact_cost_weight: float
    include_cfrc_ext_in_observation: bool = True

    @abstractmethod
    def _contact_cost(self, physics_state: PhysicsState) -> jax.Array:
        """The cost of the forces on the bodies, ``()``."""

    def _reward_readings(self) -> tuple[str, ...]:
        return self.POSITION_READING, "cfrc_ext"

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
