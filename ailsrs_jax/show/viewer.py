"""Episodes in Brax's interactive viewer, from any model of MuJoCo's."""

import json
import re
from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np

from ailsrs_jax.show.replay import Replay

# What the viewer can draw; height fields and signed distances it cannot, ellipsoids become spheres.
SHAPES = {
    mujoco.mjtGeom.mjGEOM_PLANE: "Plane",
    mujoco.mjtGeom.mjGEOM_SPHERE: "Sphere",
    mujoco.mjtGeom.mjGEOM_CAPSULE: "Capsule",
    mujoco.mjtGeom.mjGEOM_ELLIPSOID: "Sphere",
    mujoco.mjtGeom.mjGEOM_CYLINDER: "Cylinder",
    mujoco.mjtGeom.mjGEOM_BOX: "Box",
    mujoco.mjtGeom.mjGEOM_MESH: "Mesh",
}
UNSAID = (0.5, 0.5, 0.5, 1.0)  # MuJoCo's colour of geoms without one
SHOWN_GROUPS = 3  # of geoms: 0, 1 and 2, as in MuJoCo's own viewer
BESIDE = [0.32, 0.34, 0.38]  # colour of all that is not the last: the expert is grey
PLAIN = [0.4, 0.33, 0.26]  # Brax's, where the model gives no colour, or a texture


def viewer_html(replays: Sequence[Replay], labels: Sequence[str]) -> str:
    """A page that plays the episodes next to one another; it loads its scripts from the internet.

    Brax's own way to it, ``brax.io.html.render``, goes through Brax's model of the world, which
    refuses some of MuJoCo's; the viewer itself does not care.
    """
    from brax.io.html import render_from_json

    return render_from_json(json.dumps(viewer_scene(replays, labels)), "100vh", False, None)


def viewer_scene(replays: Sequence[Replay], labels: Sequence[str]) -> dict[str, Any]:
    """What the viewer takes: shapes by link, and where each link is in each step."""
    geoms: dict[str, list[dict[str, Any]]] = {}
    tracks: list[tuple[np.ndarray, np.ndarray]] = []
    last = max(replay.num_steps for replay in replays)
    for number, (replay, label) in enumerate(zip(replays, labels, strict=True)):
        model = replay.model
        positions, rotations = _bodies(replay, last)
        # Their ways apart, across the direction that most tasks walk in.
        positions = positions + np.array([0.0, 1.2 * model.stat.extent * number, 0.0])
        first = sum(track[0].shape[1] for track in tracks)
        tracks.append((positions, rotations))
        is_last = number == len(replays) - 1
        for geom in range(model.ngeom):
            body = int(model.geom_bodyid[geom])
            shape = _shape(model, geom, None if is_last else BESIDE)
            if shape is None or (body == 0 and number > 0):  # one floor is enough
                continue
            name = "world" if body == 0 else f"{label} {model.body(body).name or body}"
            link = -1 if body == 0 else first + body
            geoms.setdefault(re.sub(r"\W+", "_", name), []).append(shape | {"link_idx": link})
    both = [np.concatenate(arrays, axis=1) for arrays in zip(*tracks, strict=True)]
    states = [{"pos": p, "rot": r} for p, r in zip(*(array.round(5).tolist() for array in both))]
    return {"opt": {"timestep": replays[0].dt}, "geoms": geoms, "states": {"x": states}}


def _bodies(replay: Replay, num_steps: int) -> tuple[np.ndarray, np.ndarray]:
    """Positions ``(num_steps + 1, nbody, 3)`` [m] and unit quaternions of all bodies.

    What is over stays where it was.
    """
    data = mujoco.MjData(replay.model)
    positions, rotations = [], []
    for qpos in replay.positions:
        data.qpos[:] = qpos
        mujoco.mj_kinematics(replay.model, data)
        positions.append(data.xpos.copy())
        rotations.append(data.xquat.copy())
    rest = num_steps - replay.num_steps
    return np.stack(positions + positions[-1:] * rest), np.stack(rotations + rotations[-1:] * rest)


def _shape(model: mujoco.MjModel, geom: int, color: list[float] | None) -> dict[str, Any] | None:
    """One geom as the viewer takes it; None if it is not shown."""
    kind = SHAPES.get(mujoco.mjtGeom(model.geom_type[geom]))
    rgba = model.geom_rgba[geom]
    if kind is None or rgba[3] == 0 or model.geom_group[geom] >= SHOWN_GROUPS:
        return None
    material = model.geom_matid[geom]
    if material >= 0 and (model.mat_texid[material] < 0).all():
        rgba = model.mat_rgba[material]
    own = PLAIN if np.all(rgba == UNSAID) else rgba[:3].tolist()
    size = model.geom_size[geom].tolist()
    shape = {
        "name": kind,
        "pos": model.geom_pos[geom].tolist(),
        "rot": model.geom_quat[geom].tolist(),
        "rgba": [*(color or own), 1.0],
        # A plane without limits is a checker board; the others' halves are lengths to the viewer.
        "size": [0.0, 0.0, 0.0] if kind == "Plane" else size,
    }
    if kind == "Mesh":
        mesh = model.mesh(model.geom_dataid[geom])
        vertices = slice(mesh.vertadr[0], mesh.vertadr[0] + mesh.vertnum[0])
        faces = slice(mesh.faceadr[0], mesh.faceadr[0] + mesh.facenum[0])
        shape |= {
            "vert": model.mesh_vert[vertices].tolist(),
            "face": model.mesh_face[faces].tolist(),
        }
    return shape
