"""What ``ailsrs inspect`` tells about demonstrations."""

import gymnasium
import numpy as np
import pytest

import ailsrs_jax as ail
from ailsrs_jax.data.demonstrations import Demonstrations
from ailsrs_jax.envs import Env
from ailsrs_jax.runs.inspection.demonstrations import (
    _linearity,
    compare_steps,
    inspect_demonstrations,
)

NUM_STEPS = 150


@pytest.fixture(scope="module")
def env() -> Env:
    return ail.make_env("halfcheetah", "mujoco")


@pytest.fixture(scope="module")
def demonstrations(env: Env) -> Demonstrations:
    expert = ail.load_expert("halfcheetah")
    return ail.demonstrate(expert, 2, env=env, episode_length=NUM_STEPS)


def recorded_in(env: gymnasium.Env) -> Demonstrations:
    """Steps of the expert in an environment with the observations of HalfCheetah."""
    expert = ail.load_expert("halfcheetah")
    observation, _ = env.reset(seed=0)
    observations, actions = [], []
    for _ in range(NUM_STEPS):
        observations.append(observation)
        actions.append(expert(observation))
        observation, *_ = env.step(actions[-1])
    return Demonstrations(
        observations=np.array([observations], np.float32),
        actions=np.array([actions], np.float32),
        lengths=np.array([NUM_STEPS], np.int32),
        returns=np.zeros(1, np.float32),
        env_id="HalfCheetah-v5",
    )


def test_steps_of_the_environment_itself(env: Env, demonstrations: Demonstrations) -> None:
    for steps in (demonstrations, recorded_in(gymnasium.make("HalfCheetah-v5"))):
        difference, problem = compare_steps(steps, env)
        assert difference < 1e-3
        assert problem is None


def test_another_frame_skip(env: Env) -> None:
    _, problem = compare_steps(recorded_in(gymnasium.make("HalfCheetah-v5", frame_skip=1)), env)
    assert "changes 0.2" in str(problem)
    assert "another frame skip" in str(problem)


def test_another_version(env: Env) -> None:
    other = gymnasium.make("HalfCheetah-v5")
    other.unwrapped.model.dof_damping[:] *= 1.3
    assert "another version" in str(compare_steps(recorded_in(other), env)[1])


def test_other_scales(env: Env, demonstrations: Demonstrations) -> None:
    halved = demonstrations.replace(actions=0.5 * demonstrations.actions)
    assert "actions are 0.5 times those" in str(compare_steps(halved, env)[1])
    in_degrees = demonstrations.replace(observations=10 * demonstrations.observations)
    assert "observations are 10 times those" in str(compare_steps(in_degrees, env)[1])


def test_another_order_of_entries(env: Env, demonstrations: Demonstrations) -> None:
    order = np.random.default_rng(0).permutation(17)
    shuffled = demonstrations.replace(observations=demonstrations.observations[..., order])
    assert "another order" in str(compare_steps(shuffled, env)[1])


def test_entries_that_hold_nothing(env: Env, demonstrations: Demonstrations) -> None:
    observations = np.array(demonstrations.observations)
    observations[..., 3], observations[..., 5], observations[..., 7] = 2.0, observations[..., 4], 0
    observations[..., 9] *= 1e4
    told = inspect_demonstrations(
        demonstrations.replace(observations=observations, actions=None, stride=2), env
    ).problems
    assert told[0] == "entries of the observation are constant: 3, 7"
    assert told[1] in ("entries repeat others: 4", "entries repeat others: 5")
    assert told[2].startswith("the standard deviation of entries is far from 1: 9, from")


def test_an_expert_that_stands_still_in_the_end_is_no_division_by_zero() -> None:
    observations = np.random.default_rng(0).normal(size=(1, 100, 3)).astype(np.float32)
    actions = observations[..., :1].copy()
    actions[:, 80:] = 0.5
    resting = Demonstrations(observations, actions, np.array([100]), np.ones(1), "Task")
    assert -2.0 < _linearity(resting)["r_squared"] < 0.5


def test_a_single_step_of_each_episode_is_not_simulated_again(
    env: Env, demonstrations: Demonstrations, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("ailsrs_jax.runs.inspection.demonstrations._clones", lambda *_: {})
    single = demonstrations.replace(lengths=np.ones(2, np.int32))
    facts = inspect_demonstrations(single, env).facts
    assert facts["longest"] == 1
    assert "difference_to_simulation" not in facts


def test_states_alone_and_clones(
    env: Env, demonstrations: Demonstrations, monkeypatch: pytest.MonkeyPatch
) -> None:
    facts = inspect_demonstrations(demonstrations, env).facts
    assert (facts["episodes"], facts["transitions"]) == (2, 2 * NUM_STEPS)
    assert facts["r_squared"] > facts["r_squared_without_intercept"]
    assert 0.0 < facts["clipped_actions"] < 1.0
    assert facts["neural_clone_return"] > facts["linear_clone_return"]
    assert not facts["actions_inferred"]
    # Cloning takes long; the actions are compared without it.
    monkeypatch.setattr("ailsrs_jax.runs.inspection.demonstrations._clones", lambda *_: {})
    alone = inspect_demonstrations(demonstrations.replace(actions=None), env)
    assert alone.facts["actions_inferred"]
    assert alone.facts["difference_to_simulation"] < 0.01
    assert alone.facts["r_squared"] == pytest.approx(facts["r_squared"], abs=0.1)
    every = inspect_demonstrations(demonstrations.subsample(10).replace(actions=None), env).facts
    assert every["every"] == 10
    assert "linear_clone_return" not in every
