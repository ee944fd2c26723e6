"""Environments that work, and environments that do not, for the tests of workers."""

import contextlib
import os
import signal
import subprocess
import time
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from gymnasium.spaces import Box, Dict, Discrete


class Mass(gymnasium.Env):
    """A point mass on a line, which a force is to keep at the origin."""

    observation_space = Box(-np.inf, np.inf, (2,), np.float64)
    action_space = Box(-2.0, 2.0, (1,), np.float32)

    def reset(self, *, seed: int | None = None, options: Any = None) -> Any:
        super().reset(seed=seed)
        self.state = self.np_random.uniform(-1, 1, 2)
        return self.state.copy(), {}

    def step(self, action: np.ndarray) -> Any:
        position, velocity = self.state
        velocity += 0.1 * float(action[0])
        position += 0.1 * velocity
        self.state = np.array([position, velocity])
        reward = 1.0 - min(position**2, 1.0)
        return self.state.copy(), reward, abs(position) > 3, False, {}


class Spawning(Mass):
    """Starts a process, whose number it writes to a file, as simulators do that are programs."""

    def __init__(self) -> None:
        process = subprocess.Popen(["sleep", "300"])
        Path(os.environ["SPAWNED"]).write_text(str(process.pid))


class Named(Mass):
    """Observes a dictionary."""

    observation_space = Dict(position=Box(-9, 9, ()), velocity=Box(-9, 9, (1, 1)))

    def reset(self, **arguments: Any) -> Any:
        return self._named(super().reset(**arguments)[0]), {}

    def step(self, action: np.ndarray) -> Any:
        state, *rest = super().step(action)
        return self._named(state), *rest

    def _named(self, state: np.ndarray) -> Any:
        position, velocity = np.float32(state)
        return {"position": position, "velocity": velocity.reshape(1, 1)}


class Placed(Mass):
    """Can be put anywhere."""

    def set_observation(self, observation: np.ndarray) -> None:
        self.state = np.float64(observation)


class InPlace(Mass):
    """Moves the array that it has handed out."""

    def reset(self, **arguments: Any) -> Any:
        self.handed, info = super().reset(**arguments)
        return self.handed, info

    def step(self, action: np.ndarray) -> Any:
        self.handed[:], *rest = super().step(action)
        return self.handed, *rest


class Far(Mass):
    def reset(self, **arguments: Any) -> Any:
        observation, info = super().reset(**arguments)
        return 1e12 * observation, info


class Raising(Mass):
    def step(self, action: np.ndarray) -> Any:
        raise ZeroDivisionError("no such force")


class Diverging(Mass):
    def step(self, action: np.ndarray) -> Any:
        state, *rest = super().step(action)
        if abs(state[0]) > 0.5:
            state[1] = np.nan
        return state, *rest


def happens_first(most: int) -> bool:
    """Whether it has happened less often than ``most`` times, in any process."""
    for number in range(most):
        with contextlib.suppress(FileExistsError):
            Path(os.environ["MARKS"], str(number)).touch(exist_ok=False)
            return True
    return False


class Dying(Mass):
    """Its process is killed twice."""

    def step(self, action: np.ndarray) -> Any:
        if self.state[0] > 0.3 and happens_first(2):
            os.kill(os.getpid(), signal.SIGKILL)
        return super().step(action)


class Deadly(Mass):
    """Its process is killed whenever an episode comes to the right."""

    def step(self, action: np.ndarray) -> Any:
        if self.state[0] > 0.3:
            os.kill(os.getpid(), signal.SIGKILL)
        return super().step(action)


class Hanging(Mass):
    """Hangs once."""

    def step(self, action: np.ndarray) -> Any:
        if self.state[0] > 0.3 and happens_first(1):
            time.sleep(1000)
        return super().step(action)


class Buttons(Mass):
    action_space = Discrete(2)


class Unbounded(Mass):
    action_space = Box(-np.inf, np.inf, (1,), np.float32)


class Words(Mass):
    observation_space = gymnasium.spaces.Text(5)


gymnasium.register("Plain-v0", lambda: Mass(), max_episode_steps=40)
