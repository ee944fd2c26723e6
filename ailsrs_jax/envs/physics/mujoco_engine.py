"""MuJoCo's C engine with one thread per core, called from inside a jitted program."""

import copy
import os

import jax
import mujoco
import numpy as np

from ailsrs_jax.envs.physics.base import PhysicsState
from ailsrs_jax.envs.physics.mujoco_pools import Readings, RolloutPool, SteppingPool
from ailsrs_jax.envs.physics.quiet import without_warnings

HostState = tuple[np.ndarray, np.ndarray, np.ndarray, Readings]  # the fields of PhysicsState


def available_cores() -> int:
    """Return the number of cores that this process may use; a container can restrict them."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


class MujocoPhysics:
    """One MuJoCo model on the C engine, in float64.

    ``PhysicsState.carry`` holds the bits of MuJoCo's float64 state as pairs of uint32, so that
    nothing is rounded between steps although JAX computes in float32.

    By default MuJoCo resets a simulation that it finds unstable to the model's initial pose. Here
    its whole state is NaN from then on.
    """

    name = "mujoco"

    def __init__(
        self, model: mujoco.MjModel, frame_skip: int, readings: tuple[str, ...] = ()
    ) -> None:
        model = self.model = copy.copy(model)
        model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
        self.frame_skip = frame_skip
        self.readings = readings
        num_threads = available_cores()
        self._pool = (
            SteppingPool(model, frame_skip, num_threads, readings)
            if readings
            else RolloutPool(model, frame_skip, num_threads)
        )
        self._state_size = mujoco.mj_stateSize(model, self._pool.state_spec)
        data = mujoco.MjData(model)
        self._initial_state = np.zeros(self._state_size)
        mujoco.mj_getState(model, data, self._initial_state, self._pool.state_spec)
        self._reading_shapes = {name: getattr(data, name).shape for name in readings}
        self._state_types = (
            jax.ShapeDtypeStruct((model.nq,), np.float32),
            jax.ShapeDtypeStruct((model.nv,), np.float32),
            jax.ShapeDtypeStruct((2 * self._state_size,), np.uint32),
            {
                name: jax.ShapeDtypeStruct(shape, np.float32)
                for name, shape in self._reading_shapes.items()
            },
        )

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
        nq, nv = self.model.nq, self.model.nv  # the full state is [time, qpos, qvel, …]
        batch_shape = qpos.shape[:-1]
        full_state = np.tile(self._initial_state, (*batch_shape, 1))
        full_state[..., 1 : 1 + nq] = np.asarray(qpos)
        full_state[..., 1 + nq : 1 + nq + nv] = np.asarray(qvel)
        readings = {
            name: np.zeros((*batch_shape, *shape), np.float32)
            for name, shape in self._reading_shapes.items()
        }
        with without_warnings():
            self._pool.start(*self._rows(full_state, readings))
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
        rows = np.flatnonzero(np.asarray(live))
        if rows.size:
            controls = np.asarray(ctrl, np.float64).reshape(-1, self.model.nu)
            states, reading_rows = self._rows(full_state, new_readings)
            start_times = states[rows, 0]
            # This also makes programs on two Python threads take turns with the engine.
            with without_warnings():
                self._pool.step(rows, controls, states, reading_rows)
            states[rows[self._is_unstable(states[rows], start_times)]] = np.nan
        return self._unpack(full_state, new_readings)

    def _is_unstable(self, states: np.ndarray, start_times: np.ndarray) -> np.ndarray:
        """``(B,)`` bool: MuJoCo did not simulate all steps, or would refuse the next one."""
        due = start_times + (self.frame_skip - 0.5) * self.model.opt.timestep
        moving = states[:, 1 : 1 + self.model.nq + self.model.nv]
        # Comparisons with NaN are false.
        return ~((states[:, 0] > due) & np.all(np.abs(moving) <= mujoco.mjMAXVAL, axis=1))

    def _rows(self, full_state: np.ndarray, readings: Readings) -> tuple[np.ndarray, Readings]:
        """Reshape to one row for each simulation; the rows are views of the arguments."""
        return full_state.reshape(-1, self._state_size), {
            name: values.reshape(-1, *self._reading_shapes[name])
            for name, values in readings.items()
        }

    def _unpack(self, full_state: np.ndarray, readings: Readings) -> HostState:
        nq, nv = self.model.nq, self.model.nv
        return (
            full_state[..., 1 : 1 + nq].astype(np.float32),
            full_state[..., 1 + nq : 1 + nq + nv].astype(np.float32),
            full_state.view(np.uint32),
            readings,
        )
