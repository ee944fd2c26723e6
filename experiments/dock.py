"""An environment in a file of its own: steer a boat through a current to its berth."""

import gymnasium
import numpy as np
from gymnasium.spaces import Box

TIME_STEP = 0.1  # seconds
CURRENT = np.array([0.3, -0.2])  # m/s²


class Dock(gymnasium.Env):
    """Observes position [m], velocity [m/s] and heading of a boat; acts by thrust and rudder."""

    observation_space = Box(-np.inf, np.inf, (6,), np.float64)
    action_space = Box(-1.0, 1.0, (2,), np.float32)

    def reset(self, *, seed=None, options=None):  # noqa: ARG002
        """Start up to 4 m away, in any direction and heading."""
        super().reset(seed=seed)
        self._position = self.np_random.uniform(-4, 4, 2)
        self._velocity, self._heading = np.zeros(2), self.np_random.uniform(-np.pi, np.pi)
        return self._observe(), {}

    def step(self, action):
        """Thrust along and across the boat."""
        turn = np.array(
            [
                [np.cos(self._heading), -np.sin(self._heading)],
                [np.sin(self._heading), np.cos(self._heading)],
            ]
        )
        push = turn @ np.array([action[0], 0.5 * action[1]])
        self._velocity = self._velocity + TIME_STEP * (push + CURRENT - 0.5 * self._velocity)
        self._position = self._position + TIME_STEP * self._velocity
        distance = float(np.hypot(*self._position))
        return self._observe(), -distance, distance > 10, False, {}

    def _observe(self):
        heading = np.cos(self._heading), np.sin(self._heading)
        return np.concatenate([self._position, self._velocity, heading])


gymnasium.register("Dock-v0", Dock, max_episode_steps=150)
