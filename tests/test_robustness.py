"""The changed worlds of experiments/robustness.py."""

from typing import Any

import gymnasium
import numpy as np
import pytest

pytest.importorskip("experiments.robustness", reason="the package is installed without it")
from experiments import robustness
from experiments.robustness import (
    LateActions,
    add_noise,
    mean_return,
    scale_friction,
    scale_mass,
)


class Recorder(gymnasium.Env):
    """Observes zeros for three steps, and rewards with the action."""

    observation_space = gymnasium.spaces.Box(-1.0, 1.0, (2,))
    action_space = gymnasium.spaces.Box(-9.0, 9.0, (1,))

    def reset(self, **_: Any) -> Any:
        self.actions: list[float] = []
        return np.zeros(2), {}

    def step(self, action: np.ndarray) -> Any:
        self.actions.append(action.item())
        return np.zeros(2), action.item(), len(self.actions) == 3, False, {}


def test_mass_and_friction() -> None:
    env: Any = gymnasium.make("Hopper-v5")
    model = env.unwrapped.model
    mass, friction = model.body_mass.copy(), model.geom_friction.copy()
    scale_friction(scale_mass(env, 1.2), 1.1)
    np.testing.assert_allclose(model.body_mass, 1.2 * mass)
    np.testing.assert_allclose(model.geom_friction / friction, [[1.1, 1.0, 1.0]] * len(friction))


def test_noise_has_the_standard_deviation_of_each_entry() -> None:
    env: Any = add_noise(Recorder(), np.array([0.1, 2.0]))
    env.reset()
    noise = np.stack([env.observation(np.zeros(2)) for _ in range(2000)])
    np.testing.assert_allclose(noise.std(axis=0), [0.1, 2.0], rtol=0.1)


def test_actions_come_one_step_late(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(robustness, "NUM_EPISODES", 2)
    calls = iter(range(1, 100))
    recorder = Recorder()
    count: Any = lambda _: np.array([float(next(calls))])  # noqa: E731
    # The actions are 1, 2, 3 and 4, 5, 6.
    assert mean_return(count, recorder) == (6.0 + 15.0) / 2
    calls = iter(range(1, 100))
    assert mean_return(count, LateActions(recorder)) == (3.0 + 9.0) / 2
    assert recorder.actions == [0.0, 4.0, 5.0]
