"""The contact of a capsule and a plane, as MuJoCo's C engine has it.

Friction cones are pyramids, so it matters how a contact's frame lies in the plane. The C engine
always turns its first tangent along the capsule; MJX 3.17 does so only below 60 degrees of
inclination and takes the y axis above (google-deepmind/mujoco issue 2774). Ant stands on such steep
legs: from one in ten of the states that random policies visit, an environment step on MJX's frame
ends more than 0.4 rad/s off.
"""

import jax.numpy as jnp
from mujoco.mjx._src import collision_driver, math
from mujoco.mjx._src.collision_primitive import collider
from mujoco.mjx._src.collision_types import Collision, GeomInfo
from mujoco.mjx._src.types import GeomType


def plane_capsule(plane: GeomInfo, capsule: GeomInfo) -> Collision:
    """Distances (2,), points (2, 3) and frames (2, 3, 3) where a capsule's ends meet a plane."""
    normal, axis = plane.mat[:, 2], capsule.mat[:, 2]
    tangent, length = math.normalize_with_norm(axis - normal * jnp.dot(normal, axis))
    aligned = jnp.stack([normal, tangent, jnp.cross(normal, tangent)])
    frame = jnp.where(length > 1e-6, aligned, math.make_frame(normal))
    radius, half_length = capsule.size[:2]
    centres = capsule.pos + jnp.array([[1.0], [-1.0]]) * half_length * axis
    distances = (centres - plane.pos) @ normal - radius
    points = centres - normal * (radius + 0.5 * distances[:, None])
    return distances, points, jnp.stack([frame, frame])


def use_in_mjx() -> None:
    """Put :func:`plane_capsule` in the place of MJX's own, for the whole process."""
    collision_driver._COLLISION_FUNC[GeomType.PLANE, GeomType.CAPSULE] = collider(ncon=2)(
        plane_capsule
    )
