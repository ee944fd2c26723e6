"""The contact of a capsule and a plane, computed as in MuJoCo's C engine.

Friction cones are pyramids, so the orientation of a contact's frame in the plane matters. The C
engine always aligns the first tangent with the capsule. MJX 3.17 does so only below 60 degrees of
inclination and uses the y axis above (google-deepmind/mujoco issue 2774). Ant's legs are that
steep: from one in ten of the states that random policies visit, an environment step with MJX's
frame is wrong by more than 0.4 rad/s.
"""

import jax.numpy as jnp
from mujoco.mjx._src import collision_driver, math
from mujoco.mjx._src.collision_primitive import collider
from mujoco.mjx._src.collision_types import Collision, GeomInfo
from mujoco.mjx._src.types import GeomType


def plane_capsule(plane: GeomInfo, capsule: GeomInfo) -> Collision:
    """Distances (2,), points (2, 3) and frames (2, 3, 3) of the contacts of a capsule's ends."""
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
    """Replace MJX's own function by :func:`plane_capsule`, in the whole process."""
    collision_driver._COLLISION_FUNC[GeomType.PLANE, GeomType.CAPSULE] = collider(ncon=2)(
        plane_capsule
    )
