"""Tasks that diverge: a point mass, and a MuJoCo model that is too stiff for its time step."""

import math
from pathlib import Path

import jax
import jax.numpy as jnp

from ailsrs_jax.envs import State
from ailsrs_jax.envs.tasks.mujoco_task import MujocoTask
from tests.point_mass import PointMass

FINITE_STEPS = 5


class ExplodingPointMass(PointMass):
    """A point mass of which a share of the episodes is unstable, whatever the policy does.

    Their observations grow tenfold with every step and diverge after :data:`FINITE_STEPS`.
    """

    def __init__(self, share: float = 0.3, value: float = math.nan, place: str = "obs") -> None:
        """A diverged state has ``value`` in its field ``place``, obs or reward."""
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


# Outside ±0.35 a spring pulls back that is too stiff for the time step: each step swings the slider
# 3.7 times as far to the other side.
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
    """The slider of docs/own_task.md, started within ±0.5: three in ten episodes diverge."""

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
