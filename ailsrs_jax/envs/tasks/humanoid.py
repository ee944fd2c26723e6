"""Humanoid-v5: a biped with arms."""

import dataclasses
from typing import ClassVar

import jax
import jax.numpy as jnp

from ailsrs_jax.envs.physics import PhysicsState, Range
from ailsrs_jax.envs.tasks.gymnasium_task import SpatialWalker


@dataclasses.dataclass(eq=False, kw_only=True)
class Humanoid(SpatialWalker):
    """Gymnasium's ``Humanoid-v5``, with its constructor flags.

    Its model asks for MuJoCo's PGS solver, which MJX lacks; MJX solves the same problem by Newton's
    method. PGS, in the model's 50 iterations, stops a little short of the solution. Over the states
    that random policies visit, the velocities of the two differ after an environment step by
    1e-6 rad/s in the median and 4e-4 rad/s at the 99th percentile.
    """

    _reward_readings: ClassVar[tuple[str, ...]] = ("xipos", "cfrc_ext")

    xml_file: str = "humanoid.xml"
    forward_reward_weight: float = 1.25
    ctrl_cost_weight: float = 0.1
    contact_cost_weight: float = 5e-7
    contact_cost_range: tuple[float, float] = (-float("inf"), 10.0)
    healthy_reward: float = 5.0
    healthy_z_range: tuple[float, float] = (1.0, 2.0)
    reset_noise_scale: float = 1e-2
    include_cinert_in_observation: bool = True
    include_cvel_in_observation: bool = True
    include_qfrc_actuator_in_observation: bool = True

    def __post_init__(self, physics: str) -> None:
        super().__post_init__(physics)
        mass = self.physics.model.body_mass
        self._mass_fractions = jnp.float32(mass / mass.sum())

    def _forward_position(self, physics_state: PhysicsState) -> jax.Array:
        # The centre of mass, as a sum: a matrix product in TF32 would round it to centimetres.
        return jnp.sum(self._mass_fractions * physics_state.readings["xipos"][:, 0])

    def _healthy_ranges(self) -> tuple[Range, ...]:
        return (Range("qpos", 2, 3, *self.healthy_z_range),)

    def _contact_cost(self, physics_state: PhysicsState) -> jax.Array:
        forces = physics_state.readings["cfrc_ext"]
        cost = self.contact_cost_weight * jnp.sum(jnp.square(forces))
        return jnp.clip(cost, *self.contact_cost_range)
