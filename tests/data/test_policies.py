import numpy as np
import pytest

from ailsrs_jax.data.policies import SavedLinearPolicy, SavedMlpPolicy, expert_path, load_policy
from ailsrs_jax.envs.registry import TASKS
from ailsrs_jax.errors import UserError


def fields() -> dict[str, np.ndarray]:
    return {
        "weights": np.array([[1.0, 2.0]]),
        "mean": np.array([1.0, 0.0]),
        "std": np.array([2.0, 1.0]),
        "action_low": np.array([-1.0]),
        "action_high": np.array([4.0]),
        "env_id": np.array("Swimmer-v5"),
    }


def test_actions_of_a_loaded_policy(tmp_path) -> None:
    SavedLinearPolicy(**fields()).save(tmp_path / "policy.npz")
    policy = load_policy(tmp_path / "policy.npz")
    np.testing.assert_allclose(policy(np.array([3.0, 1.0])), [3.0])
    np.testing.assert_allclose(policy(np.array([3.0, 9.0])), [4.0])
    assert policy.env_id == "Swimmer-v5"


WRONG = {
    "weights are (2,)": {"weights": np.ones(2)},
    "mean is (3,), not (2,)": {"mean": np.ones(3)},
    "action_low is (), not (1,)": {"action_low": np.array(1.0)},
    "weights is not made of finite": {"weights": np.array([[np.nan, 1.0]])},
    "std is not positive": {"std": np.array([0.0, 1.0])},
    "std is not made of finite": {"std": np.array([1, 2])},
    "env_id is not a single string": {"env_id": np.array(3)},
}


@pytest.mark.parametrize(("message", "change"), WRONG.items())
def test_contradictions_are_named(message: str, change: dict[str, np.ndarray], tmp_path) -> None:
    np.savez(tmp_path / "wrong.npz", **(fields() | change))
    with pytest.raises(UserError) as caught:
        load_policy(tmp_path / "wrong.npz")
    assert message in str(caught.value)


def mlp_fields() -> dict[str, np.ndarray]:
    rng = np.random.default_rng(0)
    return {
        "weights_0": rng.normal(size=(4, 2)),
        "biases_0": rng.normal(size=4),
        "weights_1": rng.normal(size=(1, 4)),
        "biases_1": rng.normal(size=1),
        "mean": np.array([1.0, 0.0]),
        "std": np.array([2.0, 1.0]),
        "action_low": np.array([-1.0]),
        "action_high": np.array([4.0]),
        "action_std": np.array([0.5]),
        "env_id": np.array("Swimmer-v5"),
    }


def test_a_neural_policy_survives_saving_and_loading(tmp_path) -> None:
    np.savez(tmp_path / "a.npz", **mlp_fields())
    policy = load_policy(tmp_path / "a.npz")
    policy.save(tmp_path / "b.npz")
    again = load_policy(tmp_path / "b.npz")
    assert isinstance(again, SavedMlpPolicy)
    x = np.array([3.0, 1.0])
    np.testing.assert_array_equal(again(x), policy(x))
    hidden = mlp_fields()["weights_0"] @ np.array([1.0, 1.0]) + mlp_fields()["biases_0"]
    output = mlp_fields()["weights_1"] @ np.tanh(hidden) + mlp_fields()["biases_1"]
    np.testing.assert_allclose(policy(x), np.clip(output, -1, 4))


def test_drawn_actions_have_the_right_spread(tmp_path) -> None:
    np.savez(tmp_path / "a.npz", **mlp_fields() | {"action_low": np.array([-99.0])})
    policy = load_policy(tmp_path / "a.npz")
    rng = np.random.default_rng(1)
    actions = np.array([policy(np.zeros(2), rng) for _ in range(2000)])
    np.testing.assert_allclose(actions.mean(), policy(np.zeros(2))[0], atol=0.05)
    np.testing.assert_allclose(actions.std(), 0.5, rtol=0.05)


def test_a_deterministic_policy_has_nothing_to_draw() -> None:
    policy = SavedLinearPolicy(**fields())
    with pytest.raises(UserError, match="deterministic"):
        policy(np.zeros(2), np.random.default_rng(0))


WRONG_MLP = {
    "has no biases_1": {"biases_1": None},
    "has no weights_0": {"weights_0": None, "weights_2": np.ones((1, 1))},
    "has no action_std": {"action_std": None},
    "layers 0 and 1 are (4, 2) and (1, 3): they do not fit": {"weights_1": np.ones((1, 3))},
    "biases_0 is (3,), not (4,)": {"biases_0": np.ones(3)},
    "mean is (4,), not (2,)": {"mean": np.ones(4)},
    "action_std is (2,), not (1,)": {"action_std": np.ones(2)},
    "weights_1 is not made of finite": {"weights_1": np.full((1, 4), np.inf)},
    "weights are (0, 2): they are empty": {"weights_0": np.ones((0, 2))},
}


@pytest.mark.parametrize(("message", "change"), WRONG_MLP.items())
def test_contradictions_of_a_neural_policy_are_named(message: str, change, tmp_path) -> None:
    arrays = {name: x for name, x in (mlp_fields() | change).items() if x is not None}
    np.savez(tmp_path / "wrong.npz", **arrays)
    with pytest.raises(UserError) as caught:
        load_policy(tmp_path / "wrong.npz")
    assert message in str(caught.value)


@pytest.mark.parametrize("env_id", TASKS)
def test_an_expert_ships_for_the_task(env_id: str) -> None:
    assert load_policy(expert_path(env_id)).env_id == env_id
    assert expert_path(env_id).stat().st_size < 120_000


@pytest.mark.parametrize("env_id", ["Hopper-v5", "Walker2d-v5"])
def test_the_paper_has_its_own_expert_only_where_ours_is_better(env_id: str) -> None:
    of_paper = expert_path(env_id, "paper")
    assert load_policy(of_paper).env_id == env_id
    assert (of_paper == expert_path(env_id)) == (env_id == "Hopper-v5")


@pytest.mark.parametrize("env_id", ["HalfCheetah-v5", "Hopper-v5", "Swimmer-v5"])
def test_a_linear_expert_ships(env_id: str) -> None:
    expert = load_policy(expert_path(env_id, "linear"))
    assert isinstance(expert, SavedLinearPolicy)
    assert expert.env_id == env_id


def test_a_missing_expert_is_refused() -> None:
    with pytest.raises(UserError, match=r"no expert of my:Task ships .* --demonstrations"):
        expert_path("my:Task")
    with pytest.raises(UserError, match=r"no linear expert of my:Task ships"):
        expert_path("my:Task", "linear")
    with pytest.raises(UserError, match=r"no expert is called '\.\./x': .* paper and linear"):
        expert_path("Hopper-v5", "../x")


@pytest.mark.parametrize("kind", ["linear", "neural"])
def test_a_batch_gives_the_actions_of_its_observations(kind: str, tmp_path) -> None:
    np.savez(tmp_path / "a.npz", **(fields() if kind == "linear" else mlp_fields()))
    policy = load_policy(tmp_path / "a.npz")
    observations = np.random.default_rng(0).normal(size=(5, 2))
    expected = np.stack([policy(x) for x in observations])
    np.testing.assert_allclose(policy(observations), expected, rtol=1e-12)
    assert policy(observations[:0]).shape == (0, 1)
    np.testing.assert_array_equal(policy(observations[0].tolist()), expected[0])


@pytest.mark.parametrize("shape", [(), (1,), (3,), (2, 3), (2, 1), (1, 1, 2)])
def test_an_observation_of_another_size_is_refused(shape: tuple[int, ...]) -> None:
    policy = SavedLinearPolicy(**fields())
    with pytest.raises(UserError, match=r"the policy takes \(2,\), or a batch of them"):
        policy(np.zeros(shape))


def test_predict_draws_from_stochastic_policies_only(tmp_path) -> None:
    """Draws are reproducible with Stable-Baselines3's set_random_seed."""
    np.savez(tmp_path / "a.npz", **mlp_fields())
    policy = load_policy(tmp_path / "a.npz")
    observations = np.zeros((4, 2))
    actions, state = policy.predict(observations, state=(np.ones(1),), episode_start=np.ones(4))
    np.testing.assert_array_equal(actions, policy(observations))
    assert state == (np.ones(1),)
    draws = []
    for seed in (0, 0, 1):
        np.random.seed(seed)  # noqa: NPY002
        draws.append(policy.predict(observations, deterministic=False)[0])
    np.testing.assert_array_equal(draws[0], draws[1])
    assert not np.allclose(draws[0], draws[2])
    assert len(np.unique(draws[0])) == 4
    noise = np.random.RandomState(0).standard_normal((4, 1))
    np.testing.assert_allclose(draws[0], np.clip(actions + 0.5 * noise, -1, 4))

    linear = SavedLinearPolicy(**fields())
    np.testing.assert_array_equal(
        linear.predict(observations, deterministic=False)[0], linear(observations)
    )
