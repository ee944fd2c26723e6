"""Physics engines with a common interface."""

import jax
import mujoco

from ailsrs_jax.envs.physics.base import InitialState as InitialState
from ailsrs_jax.envs.physics.base import Perceptrons as Perceptrons
from ailsrs_jax.envs.physics.base import Physics as Physics
from ailsrs_jax.envs.physics.base import PhysicsState as PhysicsState
from ailsrs_jax.envs.physics.base import Range as Range
from ailsrs_jax.envs.physics.base import Segments as Segments
from ailsrs_jax.envs.physics.base import Trajectories as Trajectories
from ailsrs_jax.errors import UserError

ENGINES = ("mjx", "mujoco", "warp")


def choose_engine(requested: str) -> tuple[str, str]:
    """Resolve ``auto``; return the engine's name, and why it was chosen for people to read.

    Raises:
        UserError: there is no such engine, or it cannot run here.
    """
    if requested == "warp":
        from ailsrs_jax.envs.physics.warp_engine import require_warp  # slow to import

        require_warp()
    if requested in ENGINES:
        return requested, "as requested"
    if requested != "auto":
        raise UserError(
            f"unknown physics '{requested}': use auto, {', '.join(ENGINES[:-1])} or {ENGINES[-1]}"
        )
    backend = jax.default_backend()
    if backend == "cpu":
        return "mujoco", "no accelerator: MuJoCo's C engine, one thread per core"
    return "mjx", f"JAX runs on {backend}: the whole training step is one XLA program"


def make_physics(
    engine: str, model: mujoco.MjModel, frame_skip: int, readings: tuple[str, ...] = ()
) -> Physics:
    """Make the engine called ``engine`` (see :func:`choose_engine`) for ``model``.

    Its states carry the fields ``readings`` of ``mjData`` besides positions and velocities.
    """
    name, _ = choose_engine(engine)
    if name == "mjx":
        from ailsrs_jax.envs.physics.mjx_engine import MjxPhysics  # slow to import

        return MjxPhysics(model, frame_skip, readings)
    if name == "warp":
        from ailsrs_jax.envs.physics.warp_engine import WarpPhysics

        return WarpPhysics(model, frame_skip, readings)
    from ailsrs_jax.envs.physics.mujoco_engine import MujocoPhysics

    return MujocoPhysics(model, frame_skip, readings)
