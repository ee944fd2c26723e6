"""Ant's and Humanoid's base class: a robot on open ground that feels the forces on its bodies."""

import dataclasses
from abc import abstractmethod
from typing import ClassVar

import jax
import jax.numpy as jnp
import mujoco

from ailsrs_jax.envs.physics import PhysicsState
from ailsrs_jax.envs.tasks.gymnasium_task import Walker

# Each field of ``mjData`` that can be observed, and the first row that is: the rows before it
# belong to the world's body, or to the six degrees of freedom of the free joint.
FIRST_ROW = {"cinert": 1, "cvel": 1, "qfrc_actuator": 6, "cfrc_ext": 1}


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

    @property
    def observation_size(self) -> int:
        """Length n of an observation."""
        data = mujoco.MjData(self.physics.model)
        readings = [getattr(data, name)[FIRST_ROW[name] :] for name in self._observed_readings()]
        return super().observation_size + sum(reading.size for reading in readings)

    @abstractmethod
    def _contact_cost(self, physics_state: PhysicsState) -> jax.Array:
        """The cost of the forces on the bodies, ``()``."""

    def _observed_readings(self) -> list[str]:
        return [
            name for name in FIRST_ROW if getattr(self, f"include_{name}_in_observation", False)
        ]

    def _needed_readings(self) -> tuple[str, ...]:
        needed = [self.POSITION_READING, "cfrc_ext", *self._observed_readings()]
        return tuple(dict.fromkeys(needed))

    def _cost_terms(self, after: PhysicsState, action: jax.Array) -> dict[str, jax.Array]:
        terms = super()._cost_terms(after, action)
        return terms | {"reward_contact": -self._contact_cost(after)}

    def _observation(self, physics_state: PhysicsState) -> jax.Array:
        readings = [
            physics_state.readings[name][FIRST_ROW[name] :].ravel()
            for name in self._observed_readings()
        ]
        return jnp.concatenate([super()._observation(physics_state), *readings])

    def _positions(self, physics_state: PhysicsState) -> dict[str, jax.Array]:
        x, y = physics_state.qpos[:2]
        return {"x_position": x, "y_position": y, "distance_from_origin": jnp.hypot(x, y)}
