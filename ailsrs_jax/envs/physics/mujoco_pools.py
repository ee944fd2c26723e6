"""Two ways to step a batch of simulations on MuJoCo's C engine, on several threads.

Both change rows of ``states (B, s)`` and ``readings`` in place. The states are float64 in the
layout of the pool's ``state_spec`` ([time, qpos, qvel, …]). The readings are a float32 array
``(B, …)`` for each field of ``mjData`` that is read.
"""

import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import mujoco
import mujoco.rollout
import numpy as np

Readings = dict[str, np.ndarray]


class RolloutPool:
    """``mujoco.rollout`` runs entirely in C, but returns only states, no field of ``mjData``."""

    state_spec = mujoco.mjtState.mjSTATE_FULLPHYSICS.value

    def __init__(self, model: mujoco.MjModel, frame_skip: int, num_threads: int) -> None:
        self._model = model
        self._frame_skip = frame_skip
        self._data = [mujoco.MjData(model) for _ in range(num_threads)]
        self._rollout = mujoco.rollout.Rollout(nthread=num_threads)

    def start(self, states: np.ndarray, readings: Readings) -> None:
        """Do nothing: the states are complete, and there are no readings."""

    def step(
        self, rows: np.ndarray, controls: np.ndarray, states: np.ndarray, readings: Readings
    ) -> None:
        """Advance the simulations ``rows`` by ``frame_skip`` steps under ``controls (B, nu)``."""
        del readings
        controls = np.repeat(controls[rows, None], self._frame_skip, axis=1)
        trajectories, _ = self._rollout.rollout(self._model, self._data, states[rows], controls)
        states[rows] = trajectories[:, -1]


class SteppingPool:
    """Python threads, each with an ``mjData``, that make the calls of Gymnasium's ``MujocoEnv``."""

    # With the solver's warm start, a simulation continues bit for bit as if it had stayed in its
    # mjData.
    state_spec = mujoco.mjtState.mjSTATE_FULLPHYSICS.value | mujoco.mjtState.mjSTATE_WARMSTART.value

    def __init__(
        self, model: mujoco.MjModel, frame_skip: int, num_threads: int, readings: tuple[str, ...]
    ) -> None:
        self._model = model
        self._frame_skip = frame_skip
        self._readings = readings
        self._reads_forces = "cfrc_ext" in readings
        self._num_threads = num_threads
        self._own = threading.local()  # each thread's mjData and its fields
        self._threads = ThreadPoolExecutor(num_threads, initializer=self._set_up_thread)

    def _set_up_thread(self) -> None:
        """Give this thread its own ``mjData``, as an interrupted call can overlap the next one."""
        self._own.data = mujoco.MjData(self._model)
        # MuJoCo's fields never move, and looking them up for every simulation would cost more than
        # copying them.
        self._own.fields = {name: getattr(self._own.data, name) for name in self._readings}

    def start(self, states: np.ndarray, readings: Readings) -> None:
        """Set up each simulation as ``MujocoEnv.reset`` does, before any force has acted."""

        def start_one(data: mujoco.MjData, row: int) -> None:
            mujoco.mj_resetData(self._model, data)
            mujoco.mj_setState(self._model, data, states[row], self.state_spec)
            mujoco.mj_forward(self._model, data)

        self._for_each(np.arange(len(states)), start_one, states, readings)

    def step(
        self, rows: np.ndarray, controls: np.ndarray, states: np.ndarray, readings: Readings
    ) -> None:
        """Advance the simulations ``rows`` by ``frame_skip`` steps under ``controls (B, nu)``."""

        def step_one(data: mujoco.MjData, row: int) -> None:
            mujoco.mj_setState(self._model, data, states[row], self.state_spec)
            data.ctrl[:] = controls[row]
            mujoco.mj_step(self._model, data, nstep=self._frame_skip)
            if self._reads_forces:
                mujoco.mj_rnePostConstraint(self._model, data)

        self._for_each(rows, step_one, states, readings)

    def _for_each(
        self,
        rows: np.ndarray,
        simulate: Callable[[mujoco.MjData, int], None],
        states: np.ndarray,
        readings: Readings,
    ) -> None:
        # All threads take rows from this iterator; the GIL makes taking one atomic.
        waiting = iter(rows.tolist())

        def run(_: int) -> None:
            data, fields = self._own.data, self._own.fields
            for row in waiting:
                simulate(data, row)
                mujoco.mj_getState(self._model, data, states[row], self.state_spec)
                for name, values in readings.items():
                    values[row] = fields[name]

        list(self._threads.map(run, range(self._num_threads)))  # list() re-raises exceptions
