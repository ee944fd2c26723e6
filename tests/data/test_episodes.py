import numpy as np
import pytest

from ailsrs_jax.data.episodes import stack
from ailsrs_jax.data.formats.episodes import make_episode
from ailsrs_jax.errors import UserError


def test_episodes_of_different_lengths_are_padded() -> None:
    long = make_episode(np.arange(8.0).reshape(4, 2), np.ones((3, 1)), np.ones(3), "long")
    short = make_episode([[1.0, 2.0], [3.0, 4.0]], [[5.0]], [6.0], "short")
    demonstrations = stack([long, short], 5, "Hopper-v5", "here")
    assert demonstrations.observations.shape == (2, 5, 2)
    assert demonstrations.observations.dtype == np.float32
    np.testing.assert_array_equal(demonstrations.observations[0, :3], [[0, 1], [2, 3], [4, 5]])
    np.testing.assert_array_equal(demonstrations.observations[1, 0], [1, 2])
    np.testing.assert_array_equal(demonstrations.actions[1, :2], [[5], [0]])
    assert demonstrations.lengths.tolist() == [3, 1]
    assert demonstrations.returns.tolist() == [3, 6]
    assert demonstrations.env_id == "Hopper-v5"


@pytest.mark.parametrize(
    ("message", "change"),
    [
        ("observations (3, 2), actions (3, 1)", {"observations": np.zeros((3, 2))}),
        ("actions (3,) and rewards", {"actions": np.zeros(3)}),
        ("rewards (2,) are not", {"rewards": np.zeros(2)}),
        ("rewards () are not", {"rewards": None}),
        ("observations (1, 2), actions (0, 1)", {"observations": np.zeros((1, 2))}),
        ("actions are int64, not floating-point", {"actions": np.zeros((3, 1), np.int64)}),
        ("observations are object", {"observations": np.full((4, 2), None)}),
    ],
)
def test_contradictions_are_named(message: str, change: dict) -> None:
    arrays = {
        "observations": np.zeros((4, 2)),
        "actions": np.zeros((3, 1)),
        "rewards": np.zeros(3),
    } | change
    if "(0, 1)" in message:
        arrays |= {"actions": np.zeros((0, 1)), "rewards": np.zeros(0)}
    with pytest.raises(UserError) as caught:
        make_episode(**arrays, where="there: episode 7")
    assert message in str(caught.value)
    assert str(caught.value).startswith("there: episode 7: ")


def test_episodes_of_different_sizes_are_refused() -> None:
    episodes = [
        make_episode(np.zeros((2, n)), np.zeros((1, 1)), np.zeros(1), "episode") for n in (2, 3)
    ]
    with pytest.raises(UserError, match=r"here: .* differ: \[\(2, 1\), \(3, 1\)\]"):
        stack(episodes, 1, "Hopper-v5", "here")


@pytest.mark.parametrize("value", [np.nan, np.inf, 1e300])
def test_nan_and_infinity_are_refused(value: float) -> None:
    observations = np.zeros((3, 2))
    observations[1, 1] = value
    episode = make_episode(observations, np.zeros((2, 1)), np.zeros(2), "episode")
    with pytest.raises(UserError, match="here: observations hold NaN or infinity"):
        stack([episode], 2, "Hopper-v5", "here")
