"""MJX on NVIDIA's Warp: MuJoCo's own GPU code, called from the program."""

import importlib.util

import jax
import mujoco
from mujoco import mjx

from ailsrs_jax.envs.physics.base import PhysicsState
from ailsrs_jax.envs.physics.mjx_engine import MjxPhysics
from ailsrs_jax.errors import UserError

# Of all simulations of a batch together: Warp reserves memory for them, and drops what is beyond.
MAX_CONTACTS = 2**20


def require_warp() -> None:
    """Raise UserError unless Warp is installed and JAX has a CUDA device."""
    if importlib.util.find_spec("warp") is None:
        raise UserError(
            "physics 'warp' needs NVIDIA's Warp: pip install warp-lang, as the extra warp does"
        )
    if jax.default_backend() != "gpu":
        raise UserError(
            f"physics 'warp' needs a CUDA device, and JAX runs on {jax.default_backend()}: "
            "use physics mjx or mujoco"
        )


class WarpPhysics(MjxPhysics):
    """One MuJoCo model on MJX's implementation ``warp``, which nobody has run here yet."""

    name = "warp"

    def __init__(
        self, model: mujoco.MjModel, frame_skip: int, readings: tuple[str, ...] = ()
    ) -> None:
        if "cfrc_ext" in readings:
            raise UserError("physics 'warp' gives no contact forces (cfrc_ext): use physics mjx")
        super().__init__(model, frame_skip, readings)
        self._mjx_model = mjx.put_model(self.model, impl="warp")
        self._template = mjx.make_data(self.model, impl="warp", naconmax=MAX_CONTACTS)

    def step(self, state: PhysicsState, ctrl: jax.Array, live: jax.Array) -> PhysicsState:
        """See :class:`~ailsrs_jax.envs.physics.base.Physics`."""
        del live  # simulations run in lockstep
        data = self._template.replace(
            qpos=state.qpos, qvel=state.qvel, qacc_warmstart=state.carry, ctrl=ctrl
        )
        data = jax.lax.fori_loop(
            0, self.frame_skip, lambda _, data: mjx.step(self._mjx_model, data), data
        )
        readings = self._read(data) if self.readings else {}
        return PhysicsState(data.qpos, data.qvel, data.qacc_warmstart, readings)
