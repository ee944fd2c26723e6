"""HalfCheetah-v5: a planar two-legged runner that cannot fall for good."""

import dataclasses

import jax

from ailsrs_jax.envs.tasks.gymnasium_task import GymnasiumTask


@dataclasses.dataclass(eq=False, kw_only=True)
class HalfCheetah(GymnasiumTask):
    """Gymnasium's ``HalfCheetah-v5``, with its constructor flags."""

    xml_file: str = "half_cheetah.xml"
    frame_skip: int = 5
    ctrl_cost_weight: float = 0.1

    def _initial_velocity(self, key: jax.Array) -> jax.Array:
        return self._normal_velocity(key)
