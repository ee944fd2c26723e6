"""Tasks that diverge: a toy in every way there is, and a model that is too stiff for its steps."""

import math
from pathlib import Path

import jax
import jax.numpy as jnp

from ailsrs_jax.envs import State
from ailsrs_jax.envs.tasks.mujoco_task import MujocoTask
from tests.point_mass import PointMass

FINITE_STEPS = 5


class ExplodingPointMass(PointMass):
    """The point mass, of whose episodes a share is unstable, whatever the policy does.

    These observe ten times more with every step, and after :data:`FINITE_STEPS` diverge.
    """

    def __init__(self, share: float = 0.3, value: float = math.nan, place: str = "obs") -> None:
        """Diverging is to have ``value`` in the state's ``place``, obs or reward."""
        self._share, self._value, self._place = share, value, place

    def reset(self, rng: jax.Array) -> State:
        state = super().reset(rng)
        unstable = state.obs[0] < -1.0 + 2.0 * self._share
        return state.replace(pipeline_state=(unstable, jnp.zeros(()), state.obs))

    def step(self, state: State, action: jax.Array) -> State:
        unstable, time, obs = state.pipeline_state
        after = super().step(state.replace(obs=obs), action)
        growth = jnp.where(unstable, 10.0 ** (time + 1.0), 1.0)
        after = after.replace(
            obs=growth * after.obs, pipeline_state=(unstable, time + 1.0, after.obs)
        )
        diverges = unstable & (time == FINITE_STEPS)
        place = {self._place: jnp.where(diverges, self._value, getattr(after, self._place))}
        return after.replace(**place)


# Outside of ±0.35 a spring pulls back that is too stiff for the time step: with each of them it
# swings 3.7 times as far to the other side.
STIFF_SLIDER = """
<mujoco>
  <option timestep="0.01" gravity="0 0 0"/>
  <worldbody>
    <body>
      <joint name="slide" type="slide" axis="1 0 0" damping="0.5"/>
      <geom size="0.1" mass="1"/>
    </body>
  </worldbody>
  <tendon>
    <fixed springlength="-0.35 0.35" stiffness="6e4"><joint joint="slide" coef="1"/></fixed>
  </tendon>
  <actuator>
    <motor joint="slide" ctrlrange="-1 1" gear="0.1"/>
  </actuator>
</mujoco>
"""


class StiffSlider(MujocoTask):
    """docs/own_task.md's slider, starting within ±0.5: three of ten episodes diverge."""

    def __init__(self, physics: str, directory: Path) -> None:
        path = directory / "stiff_slider.xml"
        path.write_text(STIFF_SLIDER)
        super().__init__(
            physics=physics,
            xml_file=str(path),
            frame_skip=4,
            reset_noise_scale=0.5,
            num_hidden_positions=0,
        )

    def _initial_velocity(self, key: jax.Array) -> jax.Array:
        del key
        return jnp.zeros(1)

    def _reward_terms(self, before, after, action):
        return {"reward_near": 1 - abs(after.qpos[0]), "reward_ctrl": -0.1 * (action**2).sum()}
