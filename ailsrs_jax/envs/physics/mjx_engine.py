"""MuJoCo XLA: physics as pure JAX, for GPUs and TPUs, and anywhere else."""

import copy

import jax
import jax.numpy as jnp
import mujoco
from mujoco import mjx

from ailsrs_jax.envs.physics.base import PhysicsState
from ailsrs_jax.errors import UserError

# In float32 the default tolerance of 1e-8 is never reached, so every step runs all 100 solver and
# 50 line-search iterations. These settings leave the error of one environment step against the C
# engine where it was and are 3.4 times faster (tests/envs/test_gymnasium_agreement.py bounds it).
SOLVER_ITERATIONS = 6
LINE_SEARCH_ITERATIONS = 4
SOLVER_TOLERANCE = 1e-4


class MjxPhysics:
    """One MuJoCo model on MJX, in float32. Of ``PhysicsState``, ``carry`` is the warm start."""

    name = "mjx"

    def __init__(self, model: mujoco.MjModel, frame_skip: int) -> None:
        if model.na:  # PhysicsState has no place for them
            raise UserError("mjx here carries no actuator states (dyntype): use physics mujoco")
        self.model = copy.copy(model)
        self.model.opt.iterations = SOLVER_ITERATIONS
        self.model.opt.ls_iterations = LINE_SEARCH_ITERATIONS
        self.model.opt.tolerance = SOLVER_TOLERANCE
        self.frame_skip = frame_skip
        self._mjx_model = mjx.put_model(self.model)
        self._template = mjx.make_data(self.model)

    def init(self, qpos: jax.Array, qvel: jax.Array) -> PhysicsState:
        """See :class:`~ailsrs_jax.envs.physics.base.Physics`."""
        return PhysicsState(qpos=qpos, qvel=qvel, carry=jnp.zeros(self.model.nv))

    def step(self, state: PhysicsState, ctrl: jax.Array, live: jax.Array) -> PhysicsState:
        """See :class:`~ailsrs_jax.envs.physics.base.Physics`."""
        del live  # a lane of a vector unit costs the same whether its episode is over or not

        def physics_step(state: PhysicsState, _: None) -> tuple[PhysicsState, None]:
            # Everything else in mjx.Data is recomputed from these, so the loop carries 3 vectors
            # instead of the whole structure.
            data = self._template.replace(
                qpos=state.qpos, qvel=state.qvel, qacc_warmstart=state.carry, ctrl=ctrl
            )
            data = mjx.step(self._mjx_model, data)
            return PhysicsState(data.qpos, data.qvel, data.qacc_warmstart), None

        # TF32 matrix products, the default on NVIDIA GPUs, degrade the physics.
        with jax.default_matmul_precision("highest"):
            return jax.lax.scan(physics_step, state, length=self.frame_skip)[0]
