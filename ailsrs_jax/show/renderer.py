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

from ailsrs_jax.errors import UserError
from ailsrs_jax.show.replay import Replay

INSTALL = "on Debian or Ubuntu: apt-get install libegl1 libgl1, or libosmesa6"
SHADOW_SIZE = 2048  # MuJoCo's 4096 takes a third of the time that a CPU needs for a frame
# All that a picture depends on; no forces, which could make MuJoCo warn.
SEEN = (mujoco.mj_kinematics, mujoco.mj_comPos, mujoco.mj_camlight, mujoco.mj_tendon)

# A library that is there can still fail, or end the process, where there is no driver for it.
TRIAL = """
import mujoco
with mujoco.Renderer(mujoco.MjModel.from_xml_string("<mujoco/>"), 8, 8) as renderer:
    renderer.render()
"""


@functools.cache
def require_renderer() -> None:
    """Make MuJoCo render with EGL or OSMesa, or with what the variable MUJOCO_GL asks for.

    Raises:
        UserError: none works; the message says what to install.
    """
    asked = os.environ.get("MUJOCO_GL")
    ours = ("egl", "osmesa") if sys.platform == "linux" else ("",)
    for name in ours if asked is None else (asked,):
        if _renders(name):
            break
    else:
        tried = "neither EGL nor OSMesa works" if asked is None else f"MUJOCO_GL={asked} fails"
        raise UserError(f"no video: {tried} here; {INSTALL}")
    if asked is None and name:
        os.environ["MUJOCO_GL"] = name
        try:  # MuJoCo has chosen already, when it was imported
            importlib.reload(mujoco.rendering.classic.gl_context)
        except ImportError as error:  # somebody uses another library in this process
            raise UserError(
                f"no video: set the variable MUJOCO_GL={name} before Python starts"
            ) from error


def _renders(name: str) -> bool:
    """Whether a process with MUJOCO_GL set to ``name`` can render."""
    try:
        subprocess.run(
            [sys.executable, "-c", TRIAL],
            env=os.environ | {"MUJOCO_GL": name},
            check=True,
            capture_output=True,
            timeout=120,
        )
    except (subprocess.SubprocessError, OSError):
        return False
    return True


def pictures(replay: Replay, steps: Sequence[int], size: int) -> Iterator[np.ndarray]:
    """The poses after so many ``steps`` as ``(size, size, 3)`` uint8, seen by the first camera.

    A model without a camera is seen from where MuJoCo's viewer starts.

    Raises:
        UserError: there is no renderer.
    """
    require_renderer()
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
