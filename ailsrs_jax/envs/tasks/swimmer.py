"""Swimmer-v5: a planar three-link snake in a viscous fluid."""

import jax
import jax.numpy as jnp

from ailsrs_jax.envs.physics import PhysicsState
from ailsrs_jax.envs.tasks.mujoco_task import MujocoTask


class Swimmer(MujocoTask):
    """Gymnasium's ``Swimmer-v5``, with its constructor flags."""

    def __init__(
        self,
        physics: str = "auto",
        *,
        xml_file: str = "swimmer.xml",
        frame_skip: int = 4,
        forward_reward_weight: float = 1.0,
        ctrl_cost_weight: float = 1e-4,
        reset_noise_scale: float = 0.1,
        exclude_current_positions_from_observation: bool = True,
    ) -> None:
        super().__init__(
            physics=physics,
            xml_file=xml_file,
            frame_skip=frame_skip,
            reset_noise_scale=reset_noise_scale,
            num_hidden_positions=2 * exclude_current_positions_from_observation,
        )
        self._forward_reward_weight = forward_reward_weight
        self._ctrl_cost_weight = ctrl_cost_weight

    def _reward_terms(
        self, before: PhysicsState, after: PhysicsState, action: jax.Array
    ) -> dict[str, jax.Array]:
        velocity = self._forward_velocity(before, after)
        return {
            "reward_forward": self._forward_reward_weight * velocity,
            "reward_ctrl": -self._ctrl_cost_weight * jnp.sum(jnp.square(action)),
        }

    def _positions(self, physics_state: PhysicsState) -> dict[str, jax.Array]:
        return {"x_position": physics_state.qpos[0], "y_position": physics_state.qpos[1]}
