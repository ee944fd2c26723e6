"""Walker2d-v5: a planar biped."""

import dataclasses

from ailsrs_jax.envs.tasks.gymnasium_task import PlanarWalker


@dataclasses.dataclass(eq=False, kw_only=True)
class Walker2d(PlanarWalker):
    """Gymnasium's ``Walker2d-v5``, with its constructor flags."""

    xml_file: str = "walker2d_v5.xml"
    healthy_z_range: tuple[float, float] = (0.8, 2.0)
    healthy_angle_range: tuple[float, float] = (-1.0, 1.0)
