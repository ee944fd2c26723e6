import numpy as np
import pytest

from ailsrs_jax.data.policies import SavedPolicy, expert_path, load_policy
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


def test_action_by_hand_after_the_disk(tmp_path) -> None:
    SavedPolicy(**fields()).save(tmp_path / "policy.npz")
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


WITHOUT_EXPERT = ["Ant-v5", "Humanoid-v5"]


@pytest.mark.parametrize("env_id", [env_id for env_id in TASKS if env_id not in WITHOUT_EXPERT])
def test_an_expert_ships_for_the_task(env_id: str) -> None:
    assert load_policy(expert_path(env_id)).env_id == env_id
    assert expert_path(env_id).stat().st_size < 10_000


@pytest.mark.parametrize("env_id", WITHOUT_EXPERT)
def test_a_missing_expert_is_said_to_be_missing(env_id: str) -> None:
    with pytest.raises(UserError, match=f"no expert of {env_id} ships .* --demonstrations"):
        expert_path(env_id)
