import logging

import jax
import numpy as np
import pytest

import ailsrs_jax as ail
from ailsrs_jax.data.demonstrations import Demonstrations
from ailsrs_jax.envs import Env
from ailsrs_jax.runs.inverse_dynamics import infer_actions
from ailsrs_jax.runs.spec import RunSpec
from ailsrs_jax.runs.training_data import read_training_data


@pytest.fixture(scope="module")
def env() -> Env:
    return ail.make_env("swimmer", "mujoco")


@pytest.fixture(scope="module")
def demonstrations() -> Demonstrations:
    """Two episodes, of which the second is shorter; some actions are at their limits."""
    expert = ail.load_expert("swimmer")
    recorded = ail.demonstrate(expert, 2, physics="mujoco", episode_length=40)
    return recorded.replace(lengths=np.array([40, 25], np.int32))


def test_the_actions_are_found(env: Env, demonstrations: Demonstrations) -> None:
    inferred = infer_actions(demonstrations.replace(actions=None), env)
    assert inferred.actions is not None
    assert inferred.actions.shape == demonstrations.actions.shape
    for found, recorded, length in zip(
        inferred.actions, demonstrations.actions, demonstrations.lengths
    ):
        assert np.abs(recorded[: length - 1]).max() == 1.0
        np.testing.assert_allclose(found[: length - 1], recorded[: length - 1], atol=5e-3)
        np.testing.assert_array_equal(found[length - 1], found[length - 2])
        assert not found[length:].any()


def test_states_that_no_action_explains(
    env: Env, demonstrations: Demonstrations, caplog: pytest.LogCaptureFixture
) -> None:
    with caplog.at_level(logging.WARNING):
        infer_actions(demonstrations.replace(actions=None), env)
        assert not caplog.records
        backwards = demonstrations.observations[:, ::-1]
        infer_actions(demonstrations.replace(observations=backwards, actions=None), env)
    assert "no action of the environment leads from a demonstrated state" in caplog.text


def test_states_of_episodes_of_one_step(env: Env, demonstrations: Demonstrations) -> None:
    single = jax.tree.map(lambda x: x[:, :1] if np.ndim(x) == 3 else x, demonstrations)
    single = single.replace(actions=None, lengths=np.ones(2, np.int32))
    with pytest.raises(ail.UserError, match="no state with a next one"):
        infer_actions(single, env)


def test_training_data_without_actions(env: Env, demonstrations: Demonstrations) -> None:
    """The hash is of what was given; thinned states have the actions of every step."""
    spec = RunSpec("swimmer", demonstrations, states_only=True, subsample=4)
    data = read_training_data(spec, env, "Swimmer-v5", "mujoco")
    alone = demonstrations.replace(actions=None)
    same = read_training_data(RunSpec("swimmer", alone, subsample=4), env, "Swimmer-v5", "mujoco")
    assert data.sha256 == same.sha256
    assert str(data.source) == "handed in from Python, states alone"
    thinned = demonstrations.subsample(4)
    kept = thinned.alive & (thinned.lengths[:, None] > np.arange(10) + 1)
    np.testing.assert_allclose(data.infer().actions[kept], thinned.actions[kept], atol=5e-3)
    unknown = read_training_data(
        RunSpec("swimmer", alone.subsample(4)), env, "Swimmer-v5", "mujoco"
    )
    assert unknown.infer is None


def test_training_from_states_alone_begins_with_the_clone_of_the_actions(
    demonstrations: Demonstrations,
) -> None:
    tiny = {"num_directions": 1, "num_top_directions": 1, "episode_length": 40}
    options = tiny | {"num_iterations": 1, "warmup_rounds": 1, "num_evaluation_episodes": 1}
    alone, whole = (
        ail.train("swimmer", demonstrations, physics="mujoco", states_only=only, **options)
        for only in (True, False)
    )
    clone, same = (run.policies[0].weights for run in (alone, whole))
    assert np.abs(same).max() > 0.1
    np.testing.assert_allclose(clone, same, atol=0.05 * np.abs(same).max())
