"""MuJoCo's C engine with one thread per core, called from inside a jitted program."""

import copy
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor

import jax
import mujoco
import mujoco.rollout
import numpy as np

from ailsrs_jax.envs.physics.base import PhysicsState
from ailsrs_jax.envs.physics.quiet import without_warnings
from ailsrs_jax.versions import available_cores

Readings = dict[str, np.ndarray]  # float32 (..., *shape) of each field of mjData that is read
HostState = tuple[np.ndarray, np.ndarray, np.ndarray, Readings]  # the fields of PhysicsState


class MujocoPhysics:
    """One MuJoCo model on the C engine, in float64.

    ``PhysicsState.carry`` holds the bits of MuJoCo's float64 state as pairs of uint32, so that
    nothing is rounded between steps although JAX computes in float32.

    ``mujoco.rollout`` steps simulations entirely in C, but returns no field of ``mjData``. If there
    are ``readings``, Python threads make the calls of Gymnasium's ``MujocoEnv`` instead.

    By default MuJoCo resets a simulation that it finds unstable to the model's initial pose. Here
    its whole state is NaN from then on.
    """

    name = "mujoco"

    def __init__(
        self, model: mujoco.MjModel, frame_skip: int, readings: tuple[str, ...] = ()
    ) -> None:
        model = self.model = copy.copy(model)
        model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
        self.frame_skip, self.readings = frame_skip, readings
        self._num_threads = available_cores()
        self._state_spec = mujoco.mjtState.mjSTATE_FULLPHYSICS.value
        if readings:
            # With the solver's warm start, a simulation continues bit for bit as if it had stayed
            # in its mjData.
            self._state_spec |= mujoco.mjtState.mjSTATE_WARMSTART.value
            self._own = threading.local()  # each thread's mjData and its fields
            self._threads = ThreadPoolExecutor(self._num_threads)
        else:
            self._data = [mujoco.MjData(model) for _ in range(self._num_threads)]
            self._rollout = mujoco.rollout.Rollout(nthread=self._num_threads)
        data = mujoco.MjData(model)
        # The state is [time, qpos, qvel, …].
        self._initial_state = np.zeros(mujoco.mj_stateSize(model, self._state_spec))
        mujoco.mj_getState(model, data, self._initial_state, self._state_spec)
        self._qpos = slice(1, 1 + model.nq)
        self._qvel = slice(1 + model.nq, 1 + model.nq + model.nv)
        self._reading_shapes = {name: getattr(data, name).shape for name in readings}
        self._state_types = (
            jax.ShapeDtypeStruct((model.nq,), np.float32),
            jax.ShapeDtypeStruct((model.nv,), np.float32),
            jax.ShapeDtypeStruct((2 * self._initial_state.size,), np.uint32),
            {
                name: jax.ShapeDtypeStruct(shape, np.float32)
                for name, shape in self._reading_shapes.items()
            },
        )

    def _set_up_thread(self) -> None:
        """Give this thread its own ``mjData``, as an interrupted call can overlap the next one."""
        self._own.data = mujoco.MjData(self.model)
        # MuJoCo's fields never move, and looking them up for every simulation would cost more than
        # copying them.
        self._own.fields = {name: getattr(self._own.data, name) for name in self.readings}

    def init(self, qpos: jax.Array, qvel: jax.Array) -> PhysicsState:
        """See :class:`~ailsrs_jax.envs.physics.base.Physics`."""
        state = jax.pure_callback(
            self._host_init, self._state_types, qpos, qvel, vmap_method="broadcast_all"
        )
        return PhysicsState(*state)

    def step(self, state: PhysicsState, ctrl: jax.Array, live: jax.Array) -> PhysicsState:
        """See :class:`~ailsrs_jax.envs.physics.base.Physics`."""
        next_state = jax.pure_callback(
            self._host_step,
            self._state_types,
            *(state.carry, state.readings, ctrl, live),
            vmap_method="broadcast_all",
        )
        return PhysicsState(*next_state)

    def _host_init(self, qpos: jax.Array, qvel: jax.Array) -> HostState:
        batch_shape = qpos.shape[:-1]
        full_state = np.tile(self._initial_state, (*batch_shape, 1))
        full_state[..., self._qpos] = np.asarray(qpos)
        full_state[..., self._qvel] = np.asarray(qvel)
        readings = {
            name: np.zeros((*batch_shape, *shape), np.float32)
            for name, shape in self._reading_shapes.items()
        }
        states = full_state.reshape(-1, self._initial_state.size)

        def start(data: mujoco.MjData, row: int) -> None:
            """Do as ``MujocoEnv.reset``, before any force has acted."""
            mujoco.mj_resetData(self.model, data)
            mujoco.mj_setState(self.model, data, states[row], self._state_spec)
            mujoco.mj_forward(self.model, data)

        if readings:
            with without_warnings():
                self._for_each(range(len(states)), start, states, readings)
        return self._unpack(full_state, readings)

    def _host_step(
        self,
        carry: jax.Array,
        readings: dict[str, jax.Array],
        ctrl: jax.Array,
        live: jax.Array,
    ) -> HostState:
        full_state = np.array(carry).view(np.float64)
        new_readings = {name: np.array(values) for name, values in readings.items()}
        states = full_state.reshape(-1, self._initial_state.size)
        rows = np.flatnonzero(np.asarray(live))
        controls = np.asarray(ctrl, np.float64).reshape(-1, self.model.nu)

        def step(data: mujoco.MjData, row: int) -> None:
            mujoco.mj_setState(self.model, data, states[row], self._state_spec)
            data.ctrl[:] = controls[row]
            mujoco.mj_step(self.model, data, nstep=self.frame_skip)
            if "cfrc_ext" in self.readings:
                mujoco.mj_rnePostConstraint(self.model, data)

        if rows.size:
            due = states[rows, 0] + (self.frame_skip - 0.5) * self.model.opt.timestep
            # This also makes programs on two Python threads take turns with the engine.
            with without_warnings():
                if readings:
                    self._for_each(rows.tolist(), step, states, new_readings)
                else:
                    many = np.repeat(controls[rows, None], self.frame_skip, axis=1)
                    steps, _ = self._rollout.rollout(self.model, self._data, states[rows], many)
                    states[rows] = steps[:, -1]
            # MuJoCo did not simulate all steps, or would refuse the next one. Comparisons with NaN
            # are false.
            moving = states[rows, 1 : self._qvel.stop]
            stable = (states[rows, 0] > due) & np.all(np.abs(moving) <= mujoco.mjMAXVAL, axis=1)
            states[rows[~stable]] = np.nan
        return self._unpack(full_state, new_readings)

    def _for_each(
        self,
        rows: Sequence[int],
        simulate: Callable[[mujoco.MjData, int], None],
        states: np.ndarray,
        readings: Readings,
    ) -> None:
        """Let threads simulate ``rows`` of the ``states``, and store what they have come to."""
        rows_read = {
            name: readings[name].reshape(-1, *shape) for name, shape in self._reading_shapes.items()
        }
        # All threads take rows from this iterator; the GIL makes taking one atomic.
        waiting = iter(rows)

        def run(_: int) -> None:
            # As an initializer of the threads, it would keep this object as long as they live.
            if not hasattr(self._own, "data"):
                self._set_up_thread()
            data, fields = self._own.data, self._own.fields
            for row in waiting:
                simulate(data, row)
                mujoco.mj_getState(self.model, data, states[row], self._state_spec)
                for name, values in rows_read.items():
                    values[row] = fields[name]

        list(self._threads.map(run, range(self._num_threads)))  # list() re-raises exceptions

    def _unpack(self, full_state: np.ndarray, readings: Readings) -> HostState:
        return (
            full_state[..., self._qpos].astype(np.float32),
            full_state[..., self._qvel].astype(np.float32),
            full_state.view(np.uint32),
            readings,
        )
