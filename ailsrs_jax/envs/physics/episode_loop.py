"""One whole episode on MuJoCo's C engine: compiled by Numba, and run without Python's lock."""

import ctypes
from pathlib import Path
from typing import Any, NamedTuple

import mujoco
import numba
import numpy as np

from ailsrs_jax.envs.physics.base import LARGEST


class Engine(NamedTuple):
    """MuJoCo's functions, and what they are called with."""

    step: Any  # mj_step
    sense: Any  # mj_rnePostConstraint
    senses: bool  # whether it is called, after each step of the episode
    model: int  # address of the mjModel
    data: int  # address of an mjData
    frame_skip: int  # physics steps in a step of the episode


class Layout(NamedTuple):
    """Where numbers are in the memory of an ``mjData``, as indices."""

    ctrl: int  # of the first control
    moving: np.ndarray  # positions and velocities
    observed: np.ndarray  # (n,)
    lowest: np.ndarray  # (n,) float32, observations are clipped
    highest: np.ndarray  # (n,)
    watched: np.ndarray  # (w,), the episode ends when one of these is not within its limits
    low: np.ndarray  # (w,) float64
    high: np.ndarray  # (w,)
    recorded: np.ndarray  # (r,)


class Perceptron(NamedTuple):
    """A multilayer perceptron of standardised observations; a linear policy has one layer."""

    sizes: np.ndarray  # of the inputs, of each hidden layer of tanh units, and of the outputs
    parameters: np.ndarray  # float32; each layer's weights (in, out), then its biases (out,)
    mean: np.ndarray  # (n,) float32
    std: np.ndarray  # (n,)
    action_low: np.ndarray  # (p,) float32
    action_high: np.ndarray  # (p,)


class Trajectory(NamedTuple):
    """An episode of at most T steps, filled up to its end."""

    observations: np.ndarray  # (T, n) float32, what the policy saw
    actions: np.ndarray  # (T, p) float32, clipped
    records: np.ndarray  # (T + 1, r) float32, at the start and after each step
    final_observation: np.ndarray  # (n,) float32, after the last step


def mujoco_function(name: str) -> Any:
    """Return the function ``name(model, data)`` of MuJoCo's C library for compiled code."""
    directory = Path(mujoco.__file__).parent
    names = ("libmujoco.so*", "libmujoco*.dylib", "mujoco.dll")
    path = next(path for name in names for path in directory.glob(name))
    function = getattr(ctypes.CDLL(str(path)), name)
    function.restype, function.argtypes = None, [ctypes.c_void_p, ctypes.c_void_p]
    return function


@numba.njit(nogil=True, cache=True)
def run_episode(
    engine: Engine,
    memory: np.ndarray,
    warnings: np.ndarray,
    layout: Layout,
    policy: Perceptron,
    noise: np.ndarray,
    stop: np.ndarray,
    trajectory: Trajectory,
) -> tuple[int, bool, bool]:
    """Simulate an episode from the state that the ``mjData`` is in, and fill ``trajectory``.

    ``memory`` holds the numbers of the ``mjData`` in float64. ``warnings`` counts how often MuJoCo
    has found the simulation unstable, for several reasons. ``noise (T, p)`` is added to the actions
    before they are clipped; ``(0, p)`` is none. The episode ends early when ``stop (1,)`` is not 0.

    Returns:
        The number of steps, whether the next one diverged, and whether the last one has left the
        limits.
    """
    observations, actions, records, observation = trajectory
    inputs = np.empty(policy.sizes.max(), np.float32)
    outputs = np.empty(policy.sizes.max(), np.float32)
    num_layers = policy.sizes.size - 1
    for i in range(layout.recorded.size):
        records[0, i] = memory[layout.recorded[i]]
    for i in range(layout.observed.size):
        observation[i] = min(max(memory[layout.observed[i]], layout.lowest[i]), layout.highest[i])

    for t in range(len(observations)):
        for i in range(observation.size):
            inputs[i] = (observation[i] - policy.mean[i]) / policy.std[i]
        start = 0
        for layer in range(num_layers):
            num_inputs, num_outputs = policy.sizes[layer], policy.sizes[layer + 1]
            biases = start + num_inputs * num_outputs
            for j in range(num_outputs):
                outputs[j] = policy.parameters[biases + j]
            for i in range(num_inputs):
                for j in range(num_outputs):
                    outputs[j] += inputs[i] * policy.parameters[start + i * num_outputs + j]
            for j in range(num_outputs):
                inputs[j] = np.tanh(outputs[j]) if layer < num_layers - 1 else outputs[j]
            start = biases + num_outputs

        unstable = False
        for j in range(policy.action_low.size):
            action = inputs[j] + noise[t, j] if len(noise) else inputs[j]
            unstable |= np.isnan(action)
            action = min(max(action, policy.action_low[j]), policy.action_high[j])
            actions[t, j] = action
            memory[layout.ctrl + j] = action
        for _ in range(engine.frame_skip):
            engine.step(engine.model, engine.data)
        if engine.senses:
            engine.sense(engine.model, engine.data)

        unstable |= bool(warnings.any())
        for i in range(layout.moving.size):  # comparisons with NaN are false
            unstable |= not abs(memory[layout.moving[i]]) <= LARGEST
        for i in range(layout.observed.size):
            unstable |= not abs(memory[layout.observed[i]]) <= LARGEST
        if unstable or stop[0]:
            actions[t] = 0.0
            return t, unstable, False
        for i in range(layout.recorded.size):
            records[t + 1, i] = memory[layout.recorded[i]]
        for i in range(layout.observed.size):
            observations[t, i] = observation[i]
            number = memory[layout.observed[i]]
            observation[i] = min(max(number, layout.lowest[i]), layout.highest[i])
        for i in range(layout.watched.size):
            if not layout.low[i] < memory[layout.watched[i]] < layout.high[i]:
                return t + 1, False, True
    return len(observations), False, False
