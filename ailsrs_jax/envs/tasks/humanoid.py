"""Humanoid-v5: a biped with arms."""

import jax
import jax.numpy as jnp

from ailsrs_jax.envs.physics import PhysicsState
from ailsrs_jax.envs.tasks.spatial_walker import SpatialWalker


class Humanoid(SpatialWalker):
    """Gymnasium's ``Humanoid-v5``, with its constructor flags.

    Its model asks for MuJoCo's PGS solver, of which MJX has none: there the same problem is solved
    by Newton's method. PGS in the model's 50 iterations is a little short of the solution: over the
    states that random policies visit, by 1e-6 rad/s an environment step in the median and 4e-4 at
    the 99th percentile.
    """

    def __init__(
        self,
        physics: str = "auto",
        *,
        xml_file: str = "humanoid.xml",
        frame_skip: int = 5,
        forward_reward_weight: float = 1.25,
        ctrl_cost_weight: float = 0.1,
        contact_cost_weight: float = 5e-7,
        contact_cost_range: tuple[float, float] = (-float("inf"), 10.0),
        healthy_reward: float = 5.0,
        terminate_when_unhealthy: bool = True,
        healthy_z_range: tuple[float, float] = (1.0, 2.0),
        reset_noise_scale: float = 1e-2,
        exclude_current_positions_from_observation: bool = True,
        include_cinert_in_observation: bool = True,
        include_cvel_in_observation: bool = True,
        include_qfrc_actuator_in_observation: bool = True,
        include_cfrc_ext_in_observation: bool = True,
    ) -> None:
        observed = {
            "cinert": include_cinert_in_observation,
            "cvel": include_cvel_in_observation,
            "qfrc_actuator": include_qfrc_actuator_in_observation,
            "cfrc_ext": include_cfrc_ext_in_observation,
        }
        super().__init__(
            physics=physics,
            xml_file=xml_file,
            frame_skip=frame_skip,
            forward_reward_weight=forward_reward_weight,
            ctrl_cost_weight=ctrl_cost_weight,
            contact_cost_weight=contact_cost_weight,
            healthy_reward=healthy_reward,
            terminate_when_unhealthy=terminate_when_unhealthy,
            healthy_z_range=healthy_z_range,
            reset_noise_scale=reset_noise_scale,
            exclude_current_positions_from_observation=exclude_current_positions_from_observation,
            position_reading="xipos",
            observed_readings=[name for name, included in observed.items() if included],
        )
        self._contact_cost_range = contact_cost_range
        mass = self.physics.model.body_mass
        self._mass_fractions = jnp.float32(mass / mass.sum())

    def _forward_position(self, physics_state: PhysicsState) -> jax.Array:
        # The mass centre's. A sum, not a matrix product: TF32 would round positions to centimetres.
        return jnp.sum(self._mass_fractions * physics_state.readings["xipos"][:, 0])

    def _healthy(self, physics_state: PhysicsState) -> jax.Array:
        low, high = self._healthy_z_range
        height = physics_state.qpos[2]
        return (low < height) & (height < high)

    def _contact_cost(self, physics_state: PhysicsState) -> jax.Array:
        forces = physics_state.readings["cfrc_ext"]
        cost = self._contact_cost_weight * jnp.sum(jnp.square(forces))
        return jnp.clip(cost, *self._contact_cost_range)
