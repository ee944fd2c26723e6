"""MuJoCo XLA (MJX): physics in pure JAX, for GPUs, TPUs and CPUs."""

import copy

import jax
import jax.numpy as jnp
import mujoco
from mujoco import mjx

from ailsrs_jax.envs.physics import plane_capsule
from ailsrs_jax.envs.physics.base import PhysicsState
from ailsrs_jax.errors import UserError

# In float32 the default tolerance of 1e-8 is never reached, so every step would run all 100 solver
# and 50 line-search iterations. These settings are 3.4 times faster and do not increase the error
# of an environment step against the C engine (bounded in tests/envs/test_gymnasium_agreement.py).
# experiments/solver_settings.py compares: with 4, 6, 8 and 100 iterations the 99th percentile of
# the velocities' error is 5e-2, 2e-5, 2e-5 and 2e-5 rad/s on Ant, and 7e-2, 1.9e-3, 1.7e-3 and
# 1.7e-3 rad/s on Humanoid, where part of it is due to the C engine's PGS solver.
SOLVER_ITERATIONS = 6
LINE_SEARCH_ITERATIONS = 4
SOLVER_TOLERANCE = 1e-4

# The classic Runge-Kutta scheme: each stage's fraction of the time step, and its weight.
STAGE_FRACTIONS = (0.0, 1 / 2, 1 / 2, 1.0)
STAGE_WEIGHTS = (1 / 6, 1 / 3, 1 / 3, 1 / 6)


class MjxPhysics:
    """One MuJoCo model on MJX, in float32; ``PhysicsState.carry`` is the solver's warm start.

    MJX has no PGS solver. A model that asks for it (Humanoid's) gets Newton's method, which
    minimises the same function; PGS stops short of the minimum.
    """

    name = "mjx"

    def __init__(
        self, model: mujoco.MjModel, frame_skip: int, readings: tuple[str, ...] = ()
    ) -> None:
        if model.na:  # PhysicsState has no field for them
            raise UserError(
                "mjx does not support actuators with a state (dyntype) here: use physics mujoco"
            )
        plane_capsule.use_in_mjx()
        self.model = copy.copy(model)
        self.model.opt.iterations = SOLVER_ITERATIONS
        self.model.opt.ls_iterations = LINE_SEARCH_ITERATIONS
        self.model.opt.tolerance = SOLVER_TOLERANCE
        if self.model.opt.solver == mujoco.mjtSolver.mjSOL_PGS:
            self.model.opt.solver = mujoco.mjtSolver.mjSOL_NEWTON
        self.frame_skip = frame_skip
        self.readings = readings
        self._mjx_model = mjx.put_model(self.model)
        self._template = mjx.make_data(self.model)
        undamped = copy.copy(self.model)
        undamped.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_EULERDAMP
        self._undamped = mjx.put_model(undamped)

    def init(self, qpos: jax.Array, qvel: jax.Array) -> PhysicsState:
        """See :class:`~ailsrs_jax.envs.physics.base.Physics`."""
        readings = {}
        if self.readings:
            with jax.default_matmul_precision("highest"):
                data = mjx.forward(self._mjx_model, self._template.replace(qpos=qpos, qvel=qvel))
            readings = self._read(data)
        return PhysicsState(qpos, qvel, jnp.zeros(self.model.nv), readings)

    def step(self, state: PhysicsState, ctrl: jax.Array, live: jax.Array) -> PhysicsState:
        """See :class:`~ailsrs_jax.envs.physics.base.Physics`."""
        del live  # simulations run in lockstep, so skipping one saves nothing

        def physics_step(state: PhysicsState, is_last: jax.Array) -> tuple[PhysicsState, None]:
            # The rest of mjx.Data is recomputed from these, so the loop carries 3 vectors instead
            # of the whole structure.
            data = self._template.replace(
                qpos=state.qpos, qvel=state.qvel, qacc_warmstart=state.carry, ctrl=ctrl
            )
            if self.model.opt.integrator == mujoco.mjtIntegrator.mjINT_RK4:
                data = self._runge_kutta_step(data)
            else:
                data = mjx.step(self._mjx_model, data)
            readings = jax.lax.cond(is_last, self._read_forces_too, lambda _: state.readings, data)
            return PhysicsState(data.qpos, data.qvel, data.qacc_warmstart, readings), None

        # TF32 matrix products, the default on NVIDIA GPUs, degrade the physics.
        with jax.default_matmul_precision("highest"):
            is_last = jnp.arange(self.frame_skip) == self.frame_skip - 1
            return jax.lax.scan(physics_step, state, is_last)[0]

    def _runge_kutta_step(self, start: mjx.Data) -> mjx.Data:
        """Do what ``mjx.step`` does, with all four stages in one loop.

        MJX unrolls the stages, so that XLA compiles the dynamics four times. As in MJX, derived
        quantities are those of the last stage in the end.
        """
        timestep = self.model.opt.timestep

        def positions(velocity: jax.Array) -> jax.Array:
            # Without acceleration and damping, Euler's step moves by the velocity only.
            moving = start.replace(qvel=velocity, qacc=jnp.zeros_like(velocity))
            return mjx.euler(self._undamped, moving).qpos

        def stage(
            carry: tuple[mjx.Data, jax.Array, jax.Array], tableau: tuple[jax.Array, jax.Array]
        ) -> tuple[tuple[mjx.Data, jax.Array, jax.Array], None]:
            data, velocity, acceleration = carry
            fraction, weight = tableau
            data = data.replace(
                qpos=positions(fraction * data.qvel),
                qvel=start.qvel + timestep * fraction * data.qacc,
            )
            data = mjx.forward(self._mjx_model, data)
            velocity = velocity + weight * data.qvel
            acceleration = acceleration + weight * data.qacc
            return (data, velocity, acceleration), None

        zeros = jnp.zeros_like(start.qvel)
        tableau = jnp.array(STAGE_FRACTIONS), jnp.array(STAGE_WEIGHTS)
        (data, velocity, acceleration), _ = jax.lax.scan(stage, (start, zeros, zeros), tableau)
        return data.replace(
            qpos=positions(velocity),
            qvel=start.qvel + timestep * acceleration,
            qacc_warmstart=data.qacc,
        )

    def _read_forces_too(self, data: mjx.Data) -> dict[str, jax.Array]:
        if "cfrc_ext" in self.readings:  # which a physics step does not compute
            data = mjx.rne_postconstraint(self._mjx_model, data)
        return self._read(data)

    def _read(self, data: mjx.Data) -> dict[str, jax.Array]:
        fields = vars(data._impl) | vars(data)
        return {name: fields[name] for name in self.readings}
