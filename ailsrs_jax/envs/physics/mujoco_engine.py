"""MuJoCo's own C engine, one thread per core, called from inside a jitted program."""

import os
import threading

import jax
import mujoco
import mujoco.rollout
import numpy as np

from ailsrs_jax.envs.physics.base import PhysicsState

HostState = tuple[np.ndarray, np.ndarray, np.ndarray]  # the fields of PhysicsState, in NumPy


def available_cores() -> int:
    """Cores that this process may run on, which in a container can be fewer than there are."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


class MujocoPhysics:
    """One MuJoCo model on the C engine, in float64.

    Of ``PhysicsState``, ``carry`` holds the bits of MuJoCo's float64 state as pairs of uint32, so
    that nothing is rounded between steps although JAX computes in float32.
    """

    name = "mujoco"

    def __init__(self, model: mujoco.MjModel, frame_skip: int) -> None:
        self.model = model
        self.frame_skip = frame_skip
        self._state_size = mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS.value)
        num_threads = available_cores()
        self._data = [mujoco.MjData(model) for _ in range(num_threads)]
        self._pool = mujoco.rollout.Rollout(nthread=num_threads)
        self._lock = threading.Lock()  # programs on two Python threads may share this engine
        self._state_types = (
            jax.ShapeDtypeStruct((model.nq,), np.float32),
            jax.ShapeDtypeStruct((model.nv,), np.float32),
            jax.ShapeDtypeStruct((2 * self._state_size,), np.uint32),
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
            self._host_step, self._state_types, state.carry, ctrl, live, vmap_method="broadcast_all"
        )
        return PhysicsState(*next_state)

    def _host_init(self, qpos: jax.Array, qvel: jax.Array) -> HostState:
        # The full state is [time, qpos, qvel, …]: none of the models has activations or plugins.
        nq, nv = self.model.nq, self.model.nv
        full_state = np.zeros((*qpos.shape[:-1], self._state_size))
        full_state[..., 1 : 1 + nq] = np.asarray(qpos)
        full_state[..., 1 + nq : 1 + nq + nv] = np.asarray(qvel)
        return self._unpack(full_state)

    def _host_step(self, carry: jax.Array, ctrl: jax.Array, live: jax.Array) -> HostState:
        full_state = np.array(carry).view(np.float64)
        simulations = full_state.reshape(-1, self._state_size)  # a view: writes reach full_state
        rows = np.flatnonzero(np.asarray(live))
        if rows.size:
            controls = np.asarray(ctrl, np.float64).reshape(-1, self.model.nu)[rows]
            controls = np.repeat(controls[:, None], self.frame_skip, axis=1)
            with self._lock:
                states, _ = self._pool.rollout(self.model, self._data, simulations[rows], controls)
            simulations[rows] = states[:, -1]
        return self._unpack(full_state)

    def _unpack(self, full_state: np.ndarray) -> HostState:
        nq, nv = self.model.nq, self.model.nv
        return (
            full_state[..., 1 : 1 + nq].astype(np.float32),
            full_state[..., 1 + nq : 1 + nq + nv].astype(np.float32),
            full_state.view(np.uint32),
        )
