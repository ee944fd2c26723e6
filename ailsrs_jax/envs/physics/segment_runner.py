"""Segments of a fixed number of steps on MuJoCo's C engine, where one episode follows another."""

from typing import Any

import jax
import numpy as np

from ailsrs_jax.envs.physics.base import InitialState, Perceptrons, Segments, segment_types
from ailsrs_jax.envs.physics.episode_loop import Trajectory
from ailsrs_jax.envs.physics.episode_runner import EpisodeRunner, perceptrons_of
from ailsrs_jax.host_calls import host_call, zeros

Records = dict[str, jax.Array]


def run_segments(
    runner: EpisodeRunner,
    policies: Perceptrons,
    states: InitialState,
    times: jax.Array,
    restarts: InitialState,
    noise: jax.Array,
    episode_length: int,
) -> tuple[InitialState, jax.Array, Segments, tuple[Records, Records]]:
    """Go on with S episodes for L steps each; see ``MujocoTask.run_segments``.

    An episode goes on from its positions and velocities, rounded to float32.

    Returns:
        The states and times after the segments, the segments, and the recorded fields before and
        after each step.
    """
    segments = segment_types(noise.shape[:2], policies.sizes[0], policies.sizes[-1])
    records = jax.ShapeDtypeStruct((*noise.shape[:2], runner.num_recorded), np.float32)
    types = jax.eval_shape(lambda *x: x, states, times, segments, (records, records))

    def run(*inputs: Any) -> Any:
        result = zeros(types)
        _run(runner, episode_length, inputs, result)
        return result

    result = host_call(run, types, policies, states, times, restarts, noise)
    *others, (before_steps, after_steps) = result
    return (*others, (runner.by_field(before_steps), runner.by_field(after_steps)))


def _run(runner: EpisodeRunner, episode_length: int, inputs: Any, result: Any) -> None:
    """Fill ``result``, which is zeros."""
    policies, states, times, restarts, noise = inputs
    new_states, new_times, segments, records = result
    perceptrons, num_steps = perceptrons_of(policies), noise.shape[1]
    final = np.zeros((len(noise), policies.sizes[0]), np.float32)

    def run_one(i: int, stop: np.ndarray) -> None:
        start: tuple[Any, Any] = states.qpos[i], states.qvel[i]
        time, step = times[i], 0
        while step < num_steps and not stop[0]:
            most = min(num_steps - step, episode_length - time)
            trajectory = Trajectory(
                segments.observations[i, step : step + most],
                segments.actions[i, step : step + most],
                np.zeros((most + 1, runner.num_recorded), np.float32),
                final[i],
            )
            runner.begin(*start, goes_on=time > 0)
            length, diverged, terminated = runner.run_episode(
                perceptrons[i], noise[i, step:], stop, trajectory
            )
            end = step + length
            following = segments.next_observations[i, step:end]
            following[:-1], following[-1:] = trajectory.observations[1:length], final[i]
            for record, numbers in zip(
                records, (trajectory.records[:length], trajectory.records[1 : length + 1])
            ):
                record[i, step:end] = numbers
            step, time = end + diverged, time + length
            over = diverged or terminated or time == episode_length
            segments.diverged[i, step - 1] = diverged
            segments.terminated[i, step - 1] = terminated
            segments.over[i, step - 1] = over
            if over:
                start, time = (restarts.qpos[i, step - 1], restarts.qvel[i, step - 1]), 0
            else:
                start = runner.state()
        new_states.qpos[i], new_states.qvel[i] = start
        new_times[i] = time

    runner.share(run_one, len(noise))
