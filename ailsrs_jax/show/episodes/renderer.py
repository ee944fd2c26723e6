"""MuJoCo's off-screen renderer, on whichever OpenGL library works here."""

import copy
import functools
import importlib
import os
import subprocess
import sys
from collections.abc import Iterator, Sequence

import mujoco
import numpy as np
from PIL import Image, ImageOps

from ailsrs_jax.errors import UserError
from ailsrs_jax.show.episodes.replay import Film, Replay

INSTALL = "on Debian or Ubuntu: apt-get install libegl1 libgl1, or libosmesa6"
SHADOW_SIZE = 2048  # on a CPU MuJoCo's default of 4096 takes a third of the time of a frame
# Everything that a picture depends on. Forces are left out: MuJoCo could warn about them.
SEEN = (mujoco.mj_kinematics, mujoco.mj_comPos, mujoco.mj_camlight, mujoco.mj_tendon)

# Without a driver an installed library can fail or end the process, so a second process tries it.
TRIAL = """
import mujoco
with mujoco.Renderer(mujoco.MjModel.from_xml_string("<mujoco/>"), 8, 8) as renderer:
    renderer.render()
"""


@functools.cache
def require_renderer() -> None:
    """Make MuJoCo render with EGL or OSMesa, or with the library that MUJOCO_GL names.

    Raises:
        UserError: none works; the message says what to install.
    """
    asked = os.environ.get("MUJOCO_GL")
    ours = ("egl", "osmesa") if sys.platform == "linux" else ("",)
    name = next(filter(_renders, ours if asked is None else (asked,)), None)
    if name is None:
        tried = "neither EGL nor OSMesa works" if asked is None else f"MUJOCO_GL={asked} fails"
        raise UserError(f"no video: {tried} here; {INSTALL}")
    if asked is None and name:
        os.environ["MUJOCO_GL"] = name
        try:  # MuJoCo chose a library when it was imported
            importlib.reload(mujoco.rendering.classic.gl_context)
        except ImportError as error:  # another library is in use in this process
            raise UserError(
                f"no video: set the variable MUJOCO_GL={name} before Python starts"
            ) from error


def _renders(name: str) -> bool:
    """Return whether a process with MUJOCO_GL set to ``name`` can render."""
    command, environment = [sys.executable, "-P", "-c", TRIAL], os.environ | {"MUJOCO_GL": name}
    try:
        subprocess.run(command, env=environment, check=True, capture_output=True, timeout=120)
    except (subprocess.SubprocessError, OSError):
        return False
    return True


def pictures(replay: Replay | Film, steps: Sequence[int], size: int) -> Iterator[np.ndarray]:
    """Yield the poses after each of ``steps`` steps as ``(size, size, 3)`` uint8.

    They are seen by the model's first camera, or by the viewer's free camera if it has none.
    An environment of Gymnasium draws itself.

    Raises:
        UserError: there is no renderer.
    """
    require_renderer()
    if isinstance(replay, Film):
        for picture in replay.pictures(steps):
            yield np.asarray(ImageOps.pad(Image.fromarray(picture), (size, size)))
        return
    model = copy.copy(replay.model)
    model.vis.global_.offwidth = model.vis.global_.offheight = size
    model.vis.quality.shadowsize = min(model.vis.quality.shadowsize, SHADOW_SIZE)
    data = mujoco.MjData(model)
    with mujoco.Renderer(model, size, size) as renderer:
        for step in steps:
            data.qpos[:] = replay.positions[step]
            for compute in SEEN:
                compute(model, data)
            renderer.update_scene(data, camera=0 if model.ncam else -1)
            yield renderer.render()
