"""Episodes on MuJoCo's C engine: each thread runs one after the other."""

import ctypes
import itertools
import math
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from ailsrs_jax.envs.physics import episode_loop
from ailsrs_jax.envs.physics.base import (
    STATE,
    InitialState,
    Perceptrons,
    Range,
    Segments,
    Trajectories,
    segment_types,
    trajectory_types,
)
from ailsrs_jax.envs.physics.episode_loop import Engine, Layout, Perceptron, Trajectory
from ailsrs_jax.envs.physics.quiet import without_warnings
from ailsrs_jax.host_calls import POLL_SECONDS, Interrupted, host_call, interrupted, zeros

Records = dict[str, jax.Array]


class EpisodeRunner:
    """Simulates episodes of one model.

    With the same actions an episode is bit for bit that of Gymnasium's ``MujocoEnv``. It does not
    depend on the number of threads.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        frame_skip: int,
        num_threads: int,
        *,
        observed: Sequence[Range],
        limits: Sequence[Range],
        recorded: Sequence[str],
    ) -> None:
        """Prepare threads that simulate ``model``, whose automatic reset must be disabled.

        The policy sees the numbers ``observed``, clipped to their limits. An episode ends when one
        of ``limits`` is not strictly within its limits. The fields ``recorded`` are recorded.
        """
        self._model, self._frame_skip, self._num_threads = model, frame_skip, num_threads
        self._observed, self._limits = observed, limits
        self._recorded = [Range(field) for field in recorded]
        self._senses = any(part.field == "cfrc_ext" for part in (*observed, *self._recorded))
        data = mujoco.MjData(model)
        self._shapes = {name: getattr(data, name).shape for name in recorded}
        self._num_recorded = sum(map(math.prod, self._shapes.values()))
        self._step, self._sense = map(
            episode_loop.mujoco_function, ("mj_step", "mj_rnePostConstraint")
        )
        self._own = threading.local()
        self._threads = ThreadPoolExecutor(num_threads)

    def run_episodes(
        self,
        policies: Perceptrons,
        starts: InitialState,
        noise: jax.Array,
        episode_length: int,
    ) -> Trajectories:
        """Simulate an episode of each policy, in a JAX program; see ``MujocoTask.run_episodes``.

        The ``records`` are a dictionary with ``(B, T + 1, ...)`` of each field.
        """
        sizes = policies.sizes
        types = trajectory_types(
            len(noise), episode_length, sizes[0], sizes[-1], self._num_recorded
        )

        def run(policies: Perceptrons, starts: InitialState, noise: np.ndarray) -> Trajectories:
            result: Trajectories = zeros(types)
            perceptrons = _perceptrons(policies)

            def run_one(i: int, stop: np.ndarray) -> None:
                self._begin(starts.qpos[i], starts.qvel[i])
                result.lengths[i], result.diverged[i], _ = self._run(
                    perceptrons[i], noise[i], stop, Trajectory(*(array[i] for array in result[:4]))
                )

            self._share(run_one, len(noise))
            return result

        result = host_call(run, types, policies, starts, noise)
        return result._replace(records=self._by_field(result.records))

    def run_segments(
        self,
        policies: Perceptrons,
        states: InitialState,
        times: jax.Array,
        restarts: InitialState,
        noise: jax.Array,
        episode_length: int,
    ) -> tuple[InitialState, jax.Array, Segments, tuple[Records, Records]]:
        """Go on with S episodes for L steps each; see ``MujocoTask.run_segments``.

        An episode goes on from its positions and velocities, rounded to float32. The forces that
        its first observation shows are those of this state; elsewhere, as in Gymnasium, they are
        those before the last physics step.

        Returns:
            The states and times after the segments, the segments, and the recorded fields before
            and after each step.
        """
        segments = segment_types(noise.shape[:2], policies.sizes[0], policies.sizes[-1])
        records = jax.ShapeDtypeStruct((*noise.shape[:2], self._num_recorded), np.float32)
        types = jax.eval_shape(lambda *x: x, states, times, segments, (records, records))

        def run(
            policies: Perceptrons, states: Any, times: Any, restarts: Any, noise: np.ndarray
        ) -> Any:
            result = zeros(types)
            new_states, new_times, segments, records = result
            perceptrons, num_steps = _perceptrons(policies), noise.shape[1]
            final = np.zeros((len(noise), policies.sizes[0]), np.float32)

            def run_one(i: int, stop: np.ndarray) -> None:
                start: tuple[Any, Any] = states.qpos[i], states.qvel[i]
                time, step = times[i], 0
                while step < num_steps and not stop[0]:
                    most = min(num_steps - step, episode_length - time)
                    trajectory = Trajectory(
                        segments.observations[i, step : step + most],
                        segments.actions[i, step : step + most],
                        np.zeros((most + 1, self._num_recorded), np.float32),
                        final[i],
                    )
                    self._begin(*start, goes_on=time > 0)
                    length, diverged, terminated = self._run(
                        perceptrons[i], noise[i, step:], stop, trajectory
                    )
                    end = step + length
                    following = segments.next_observations[i, step:end]
                    following[:-1], following[-1:] = trajectory.observations[1:length], final[i]
                    records[0][i, step:end] = trajectory.records[:length]
                    records[1][i, step:end] = trajectory.records[1 : length + 1]
                    step, time = end + diverged, time + length
                    over = diverged or terminated or time == episode_length
                    segments.diverged[i, step - 1] = diverged
                    segments.terminated[i, step - 1] = terminated
                    segments.over[i, step - 1] = over
                    if over:
                        start, time = (restarts.qpos[i, step - 1], restarts.qvel[i, step - 1]), 0
                    else:
                        start = self._own.data.qpos.copy(), self._own.data.qvel.copy()
                new_states.qpos[i], new_states.qvel[i] = start
                new_times[i] = time

            self._share(run_one, len(noise))
            return result

        result = host_call(run, types, policies, states, times, restarts, noise)
        *others, (before, after) = result
        return (*others, (self._by_field(before), self._by_field(after)))

    def _by_field(self, records: jax.Array) -> Records:
        """Split ``records (B, T, r)`` into the recorded fields ``(B, T, ...)``."""
        ends = np.cumsum([math.prod(shape) for shape in self._shapes.values()])
        parts = jnp.split(records, ends[:-1], axis=2)
        return {
            name: numbers.reshape(*records.shape[:2], *shape)
            for (name, shape), numbers in zip(self._shapes.items(), parts, strict=True)
        }

    def _begin(self, qpos: Any, qvel: Any, goes_on: bool = False) -> None:
        """Put this thread's ``mjData`` into a state, perhaps in the middle of an episode.

        As in Gymnasium's ``MujocoEnv.reset``, no force has acted yet at the beginning.
        """
        data = self._own.data
        mujoco.mj_resetData(self._model, data)
        data.qpos[:], data.qvel[:] = qpos, qvel
        mujoco.mj_forward(self._model, data)
        if goes_on and self._senses:
            mujoco.mj_rnePostConstraint(self._model, data)

    def _run(
        self, policy: Perceptron, noise: np.ndarray, stop: np.ndarray, trajectory: Trajectory
    ) -> tuple[int, bool, bool]:
        """Call :func:`~ailsrs_jax.envs.physics.episode_loop.run_episode` from there on."""
        own = self._own
        return episode_loop.run_episode(
            own.engine, own.memory, own.warnings, own.layout, policy, noise, stop, trajectory
        )

    def _share(self, run_one: Callable[[int, np.ndarray], None], number: int) -> None:
        """Let the threads share the calls ``run_one(i, stop)`` for ``i`` in ``range(number)``.

        Raises:
            Interrupted: somebody asked for a stop.
        """
        stop = np.zeros(1, bool)
        # All threads take numbers from this iterator; Python's lock makes taking one atomic.
        waiting = iter(range(number))

        def run_some() -> None:
            # As an initializer of the threads, it would keep this object as long as they live.
            if not hasattr(self._own, "data"):
                self._set_up_thread()
            for i in itertools.takewhile(lambda _: not stop[0], waiting):
                run_one(i, stop)

        with without_warnings():
            running = [self._threads.submit(run_some) for _ in range(self._num_threads)]
            while wait(running, POLL_SECONDS).not_done:
                stop[0] = interrupted()
        for thread in running:
            thread.result()  # raises what the thread has raised
        if stop[0]:
            raise Interrupted

    def _set_up_thread(self) -> None:
        """Give this thread an ``mjData``, and find the fields in its memory."""
        own, data = self._own, mujoco.MjData(self._model)
        state = tuple(map(Range, STATE))
        parts = (*self._observed, *self._limits, *self._recorded, *state)
        fields = {name: getattr(data, name) for name in ("ctrl", *(part.field for part in parts))}
        # All fields lie in one buffer, which never moves.
        start = min(field.ctypes.data for field in fields.values())
        end = max(field.ctypes.data + field.nbytes for field in fields.values())
        place = {name: (field.ctypes.data - start) // 8 for name, field in fields.items()}

        def numbers(parts: Sequence[Range]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
            """Return index, lowest and highest value of each number."""
            rows = [
                (place[part.field] + index, part.low, part.high)
                for part in parts
                for index in range(fields[part.field].size)[part.first : part.end]
            ]
            index, low, high = np.array(rows, float).reshape(-1, 3).T.copy()
            return index.astype(int), low, high

        observed, lowest, highest = numbers(self._observed)
        watched, low, high = numbers(self._limits)
        own.data = data
        own.memory = np.frombuffer((ctypes.c_char * (end - start)).from_address(start))
        own.warnings = data.warning.number[mujoco.mjtWarning.mjWARN_BADQPOS :]
        own.engine = Engine(
            step=self._step,
            sense=self._sense,
            senses=self._senses,
            model=self._model._address,
            data=data._address,
            frame_skip=self._frame_skip,
        )
        own.layout = Layout(
            ctrl=place["ctrl"],
            moving=numbers(state)[0],
            observed=observed,
            lowest=lowest.astype(np.float32),
            highest=highest.astype(np.float32),
            watched=watched,
            low=low,
            high=high,
            recorded=numbers(self._recorded)[0],
        )


def _perceptrons(policies: Perceptrons) -> list[Perceptron]:
    """Return each of the policies, for compiled code."""
    sizes = np.array(policies.sizes)
    return [Perceptron(sizes, *arrays) for arrays in zip(*jax.tree.leaves(policies), strict=True)]
