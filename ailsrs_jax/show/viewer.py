"""Episodes of any MuJoCo model in Brax's interactive viewer."""

import json
import re
from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np

from ailsrs_jax.show.replay import Replay

# The viewer draws no height fields and no signed distances, and ellipsoids as spheres.
SHAPES = {
    mujoco.mjtGeom.mjGEOM_PLANE: "Plane",
    mujoco.mjtGeom.mjGEOM_SPHERE: "Sphere",
    mujoco.mjtGeom.mjGEOM_CAPSULE: "Capsule",
    mujoco.mjtGeom.mjGEOM_ELLIPSOID: "Sphere",
    mujoco.mjtGeom.mjGEOM_CYLINDER: "Cylinder",
    mujoco.mjtGeom.mjGEOM_BOX: "Box",
    mujoco.mjtGeom.mjGEOM_MESH: "Mesh",
}
UNSET = (0.5, 0.5, 0.5, 1.0)  # MuJoCo's colour of geoms without one
SHOWN_GROUPS = 3  # geoms of groups 0, 1 and 2 are shown, as in MuJoCo's own viewer
GREY = [0.32, 0.34, 0.38]  # of every episode but the last, such as the expert's
PLAIN = [0.4, 0.33, 0.26]  # Brax's colour where the model gives none, or a texture


def viewer_html(replays: Sequence[Replay], labels: Sequence[str]) -> str:
    """Return a page that plays the episodes side by side; its scripts come from the internet.

    ``brax.io.html.render`` would need a model of Brax's, which rejects some of MuJoCo's features
    that the viewer itself can draw.
    """
    from brax.io.html import render_from_json

    return render_from_json(json.dumps(viewer_scene(replays, labels)), "100vh", False, None)


def viewer_scene(replays: Sequence[Replay], labels: Sequence[str]) -> dict[str, Any]:
    """Return the viewer's input: shapes by link, and the pose of each link in each step."""
    geoms: dict[str, list[dict[str, Any]]] = {}
    poses: list[tuple[np.ndarray, np.ndarray]] = []
    num_steps = max(replay.num_steps for replay in replays)
    for number, (replay, label) in enumerate(zip(replays, labels, strict=True)):
        model, first = replay.model, sum(positions.shape[1] for positions, _ in poses)
        positions, rotations = _body_poses(replay, num_steps)
        # Apart along y: most tasks move along x.
        positions[:, :, 1] += 1.2 * model.stat.extent * number
        poses.append((positions, rotations))
        for geom in range(model.ngeom):
            body = int(model.geom_bodyid[geom])
            shape = _shape(model, geom)
            if shape is None or (body == 0 and number > 0):  # one floor is enough
                continue
            if number < len(replays) - 1:
                shape["rgba"] = [*GREY, 1.0]
            name = "world" if body == 0 else f"{label} {model.body(body).name or body}"
            shape["link_idx"] = -1 if body == 0 else first + body
            geoms.setdefault(re.sub(r"\W+", "_", name), []).append(shape)
    together = (np.concatenate(arrays, axis=1).round(5).tolist() for arrays in zip(*poses))
    states = [{"pos": positions, "rot": rotations} for positions, rotations in zip(*together)]
    return {"opt": {"timestep": replays[0].dt}, "geoms": geoms, "states": {"x": states}}


def _body_poses(replay: Replay, num_steps: int) -> tuple[np.ndarray, np.ndarray]:
    """Return positions ``(num_steps + 1, nbody, 3)`` [m] and unit quaternions of all bodies.

    After the end of the episode the last pose stays.
    """
    data = mujoco.MjData(replay.model)
    positions, rotations = [], []
    for step in range(num_steps + 1):
        data.qpos[:] = replay.positions[min(step, replay.num_steps)]
        mujoco.mj_kinematics(replay.model, data)
        positions.append(data.xpos.copy())
        rotations.append(data.xquat.copy())
    return np.stack(positions), np.stack(rotations)


def _shape(model: mujoco.MjModel, geom: int) -> dict[str, Any] | None:
    """Return one geom as the viewer reads it, or None if it is not shown."""
    kind = SHAPES.get(mujoco.mjtGeom(model.geom_type[geom]))
    rgba, material = model.geom_rgba[geom], model.geom_matid[geom]
    if kind is None or rgba[3] == 0 or model.geom_group[geom] >= SHOWN_GROUPS:
        return None
    if material >= 0 and (model.mat_texid[material] < 0).all():
        rgba = model.mat_rgba[material]
    # A plane of size 0 has no edges and is drawn as a checker board.
    size = [0.0, 0.0, 0.0] if kind == "Plane" else model.geom_size[geom].tolist()
    color = PLAIN if np.all(rgba == UNSET) else rgba[:3].tolist()
    position, rotation = model.geom_pos[geom].tolist(), model.geom_quat[geom].tolist()
    shape = {"name": kind, "pos": position, "rot": rotation, "size": size, "rgba": [*color, 1.0]}
    if kind == "Mesh":
        mesh = model.mesh(model.geom_dataid[geom])
        vertices = slice(mesh.vertadr[0], mesh.vertadr[0] + mesh.vertnum[0])
        faces = slice(mesh.faceadr[0], mesh.faceadr[0] + mesh.facenum[0])
        shape["vert"] = model.mesh_vert[vertices].tolist()
        shape["face"] = model.mesh_face[faces].tolist()
    return shape
