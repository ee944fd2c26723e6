"""Ant-v5: a four-legged robot."""

import jax
import jax.numpy as jnp

from ailsrs_jax.envs.physics import PhysicsState
from ailsrs_jax.envs.tasks.spatial_walker import SpatialWalker
from ailsrs_jax.errors import UserError


class Ant(SpatialWalker):
    """Gymnasium's ``Ant-v5``, with its constructor flags."""

    def __init__(
        self,
        physics: str = "auto",
        *,
        xml_file: str = "ant.xml",
        frame_skip: int = 5,
        forward_reward_weight: float = 1.0,
        ctrl_cost_weight: float = 0.5,
        contact_cost_weight: float = 5e-4,
        healthy_reward: float = 1.0,
        main_body: int | str = 1,
        terminate_when_unhealthy: bool = True,
        healthy_z_range: tuple[float, float] = (0.2, 1.0),
        contact_force_range: tuple[float, float] = (-1.0, 1.0),
        reset_noise_scale: float = 0.1,
        exclude_current_positions_from_observation: bool = True,
        include_cfrc_ext_in_observation: bool = True,
    ) -> None:
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
            position_reading="xpos",
            observed_readings=["cfrc_ext"] if include_cfrc_ext_in_observation else [],
        )
        self._contact_force_range = contact_force_range
        try:
            self._main_body = self.physics.model.body(main_body).id
        except (KeyError, IndexError) as error:
            raise UserError(f"Ant-v5: {xml_file} has no body {main_body!r}") from error

    def _forward_position(self, physics_state: PhysicsState) -> jax.Array:
        return physics_state.readings["xpos"][self._main_body, 0]

    def _healthy(self, physics_state: PhysicsState) -> jax.Array:
        low, high = self._healthy_z_range
        height = physics_state.qpos[2]
        state = jnp.concatenate([physics_state.qpos, physics_state.qvel])
        return jnp.isfinite(state).all() & (low <= height) & (height <= high)

    def _contact_forces(self, physics_state: PhysicsState) -> jax.Array:
        return jnp.clip(physics_state.readings["cfrc_ext"], *self._contact_force_range)

    def _contact_cost(self, physics_state: PhysicsState) -> jax.Array:
        forces = self._contact_forces(physics_state)
        return self._contact_cost_weight * jnp.sum(jnp.square(forces))

    def _initial_velocity(self, key: jax.Array) -> jax.Array:
        return self._reset_noise_scale * jax.random.normal(key, (self.physics.model.nv,))

    def _observation(self, physics_state: PhysicsState) -> jax.Array:
        forces = {"cfrc_ext": self._contact_forces(physics_state)}
        return super()._observation(physics_state.replace(readings=forces))
