"""Episodes of any MuJoCo model in Brax's interactive viewer."""

import json
import re
from collections.abc import Sequence
from importlib import resources
from typing import Any

import mujoco
import numpy as np

from ailsrs_jax.show.episodes.replay import Replay

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

    To Brax's page, ``viewer.html`` adds the labels, the view, and what one reads without a network.
    ``brax.io.html.render`` would need a model of Brax's, which rejects some of MuJoCo's features
    that the viewer itself can draw.
    """
    from brax.io.html import render_from_json

    scene = json.dumps(viewer_scene(replays, labels))
    added = resources.files("ailsrs_jax.show.episodes").joinpath("viewer.html").read_text()
    return render_from_json(scene, "100vh", False, None).replace("<body>", f"<body>\n{added}")


def viewer_scene(replays: Sequence[Replay], labels: Sequence[str]) -> dict[str, Any]:
    """Return the viewer's input: shapes by link, and the pose of each link in each step.

    The last episode comes first: the viewer follows the first body. ``labels`` and ``size`` [m] are
    for ``viewer.html``.
    """
    geoms: dict[str, list[dict[str, Any]]] = {}
    labelled: dict[str, str] = {}  # the name of the first body of each episode
    poses: list[tuple[np.ndarray, np.ndarray]] = []
    num_steps = max(replay.num_steps for replay in replays)
    size = _size(replays[-1].model)
    for number, (replay, label) in enumerate(reversed([*zip(replays, labels, strict=True)])):
        model, first = replay.model, sum(positions.shape[1] for positions, _ in poses)
        positions, rotations = _body_poses(replay, num_steps)
        # Apart along y, away from the camera: most tasks move along x.
        positions[:, :, 1] += 1.2 * size * number
        poses.append((positions, rotations))
        for geom in range(model.ngeom):
            body = int(model.geom_bodyid[geom])
            shape = _shape(model, geom)
            if shape is None or (body == 0 and number > 0):  # one floor is enough
                continue
            if number > 0:
                shape["rgba"] = [*GREY, 1.0]
            name = "world" if body == 0 else f"{label} {model.body(body).name or body}"
            name = re.sub(r"\W+", "_", name)
            shape["link_idx"] = -1 if body == 0 else first + body
            geoms.setdefault(name, []).append(shape)
            if body > 0:
                labelled.setdefault(label, name)
    together = (np.concatenate(arrays, axis=1).round(5).tolist() for arrays in zip(*poses))
    states = [{"pos": positions, "rot": rotations} for positions, rotations in zip(*together)]
    return {
        "opt": {"timestep": replays[0].dt},
        "geoms": geoms,
        "states": {"x": states},
        "labels": labelled,
        "size": size,
    }


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


def _size(model: mujoco.MjModel) -> float:
    """Return how far the moving geoms reach along the longest axis [m]."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    moving = model.geom_bodyid > 0
    if not moving.any():
        return 1.0
    centers, radii = data.geom_xpos[moving], model.geom_rbound[moving, None]
    return float(((centers + radii).max(axis=0) - (centers - radii).min(axis=0)).max())


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
