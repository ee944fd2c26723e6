import io
import pickle
import zipfile

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ailsrs_jax.data.demonstrations import Demonstrations, load_demonstrations, save_demonstrations
from ailsrs_jax.errors import UserError
from tests.fuzz.archives import demonstration_arrays


def arrays() -> dict[str, np.ndarray]:
    return {name: x for name, x in demonstration_arrays().items() if name != "stride"}


def test_demonstrations_survive_saving_and_loading(tmp_path) -> None:
    original = Demonstrations(**(arrays() | {"env_id": "Hopper-v5"}))
    save_demonstrations(original, tmp_path / "new" / "demonstrations.npz")
    loaded = load_demonstrations(tmp_path / "new" / "demonstrations.npz")
    assert loaded.env_id == "Hopper-v5"
    for name in ("lengths", "returns"):
        np.testing.assert_array_equal(getattr(loaded, name), getattr(original, name))
    for name in ("observations", "actions"):
        ours, theirs = getattr(loaded, name), getattr(original, name)
        np.testing.assert_array_equal(ours[loaded.alive], theirs[loaded.alive])
        assert not ours[~loaded.alive].any()
    assert [path.name for path in (tmp_path / "new").iterdir()] == ["demonstrations.npz"]


def test_first(tmp_path) -> None:
    demonstrations = Demonstrations(**(arrays() | {"env_id": "Hopper-v5"}))
    assert demonstrations.first(2).observations.shape == (2, 5, 4)
    for number in (0, 4, -1):
        with pytest.raises(UserError, match="hold 3"):
            demonstrations.first(number)


def with_nan(array: np.ndarray) -> np.ndarray:
    array = array.copy()
    array[0, 0, 0] = np.nan
    return array


WRONG = {
    "observations are (3, 20), not (E, T, n)": {"observations": np.zeros((3, 20))},
    "actions (3, 4, 2) do not match observations": {"actions": np.zeros((3, 4, 2))},
    "actions are (3, 5), not (E, T, p)": {"actions": np.zeros((3, 5))},
    "there are no observations": {"observations": np.zeros((0, 5, 4))},
    "lengths are (2,), not (3,)": {"lengths": np.array([1, 2])},
    "lengths are not integers": {"lengths": np.array([1.0, 2.0, 3.0])},
    "lengths are not all between 1 and 5": {"lengths": np.array([6, 1, 1])},
    "returns are (3, 1), not (3,)": {"returns": np.zeros((3, 1))},
    "returns are not numbers": {"returns": np.array(["a", "b", "c"])},
    "observations hold NaN or infinity": {"observations": with_nan(arrays()["observations"])},
    "actions hold NaN or infinity": {"actions": np.full((3, 5, 2), np.inf)},
    "observations are not floating-point numbers": {"observations": np.zeros((3, 5, 4), int)},
    "env_id is not a single string": {"env_id": np.array([1, 2])},
    "stride is not a single positive": {"stride": np.array(0)},
    "stride is not a single positive integer": {"stride": np.array(1.5)},
    "stride is not a single": {"stride": np.array("NaT", "timedelta64[Y]")},
    "lengths are not": {"lengths": np.ones(3, "timedelta64[s]")},
    "pickled objects": {"observations": np.array([[object()]])},
}


@pytest.mark.parametrize(("message", "change"), WRONG.items())
def test_contradictions_are_named(message: str, change: dict[str, np.ndarray], tmp_path) -> None:
    path = tmp_path / "wrong.npz"
    np.savez(path, **(arrays() | change))
    with pytest.raises(UserError) as caught:
        load_demonstrations(path)
    assert message in str(caught.value)


def test_nan_after_an_episodes_end_becomes_zero(tmp_path) -> None:
    padded = arrays()
    padded["observations"][2, 3] = np.nan
    np.savez(tmp_path / "padded.npz", **padded)
    loaded = load_demonstrations(tmp_path / "padded.npz")
    assert np.isfinite(loaded.observations).all()


def test_missing_files_and_fields(tmp_path) -> None:
    with pytest.raises(UserError, match="no such file"):
        load_demonstrations(tmp_path / "none.npz")
    with pytest.raises(UserError):
        load_demonstrations(tmp_path)
    incomplete = arrays()
    del incomplete["lengths"]
    np.savez(tmp_path / "incomplete.npz", **incomplete)
    with pytest.raises(UserError, match="has no lengths"):
        load_demonstrations(tmp_path / "incomplete.npz")
    np.save(tmp_path / "single.npy", np.zeros(3))
    with pytest.raises(UserError, match=r"not a \.npz file"):
        load_demonstrations(tmp_path / "single.npy")


def test_a_pickle_is_never_run(tmp_path) -> None:
    marker = tmp_path / "executed"

    class Malicious:
        def __reduce__(self) -> tuple:
            return (open, (str(marker), "w"))

    (tmp_path / "pickle.npz").write_bytes(pickle.dumps(Malicious()))
    with zipfile.ZipFile(tmp_path / "inside.npz", "w") as archive:
        buffer = io.BytesIO()
        np.save(buffer, np.array([Malicious()], dtype=object), allow_pickle=True)
        for name in arrays():
            archive.writestr(f"{name}.npy", buffer.getvalue())
    for name in ("pickle.npz", "inside.npz"):
        with pytest.raises(UserError):
            load_demonstrations(tmp_path / name)
    assert not marker.exists()


def state_only() -> Demonstrations:
    return Demonstrations(**(arrays() | {"actions": None, "env_id": "Hopper-v5"}))


def test_demonstrations_without_actions(tmp_path) -> None:
    save_demonstrations(state_only(), tmp_path / "states.npz")
    with np.load(tmp_path / "states.npz") as archive:
        assert sorted(archive.files) == ["env_id", "lengths", "observations", "returns"]
    loaded = load_demonstrations(tmp_path / "states.npz")
    assert loaded.actions is None
    assert loaded.first(2).actions is None
    subsampled = loaded.subsample(2)
    assert subsampled.actions is None
    assert subsampled.observations.shape == (3, 2, 4)


def test_the_stride_is_saved(tmp_path) -> None:
    subsampled = Demonstrations(**(arrays() | {"env_id": "Hopper-v5"})).subsample(2)
    save_demonstrations(subsampled, tmp_path / "every_second.npz")
    loaded = load_demonstrations(tmp_path / "every_second.npz")
    assert loaded.stride == 2
    np.testing.assert_array_equal(loaded.lengths, subsampled.lengths)
    assert loaded.subsample(2).stride == 4


@st.composite
def clocks(draw: st.DrawFn) -> tuple[Demonstrations, int]:
    """Episodes that observe their number and the time, and a k: every k-th entry is kept."""
    num_steps = draw(st.integers(1, 40))
    lengths = draw(st.lists(st.integers(1, num_steps), min_size=1, max_size=8))
    number, time = np.indices((len(lengths), num_steps), np.float32)
    demonstrations = Demonstrations(
        observations=np.stack([number, time], axis=-1),
        actions=time[..., None],
        lengths=np.array(lengths),
        returns=np.arange(len(lengths)).astype(np.float32),
        env_id="Clock",
    )
    return demonstrations, draw(st.integers(1, num_steps))


@given(clocks(), st.integers(0, 2**31 - 1))
def test_subsampling_keeps_every_kth_step_after_a_random_offset(drawn, seed: int) -> None:
    demonstrations, every = drawn
    num_blocks = demonstrations.observations.shape[1] // every
    subsampled = demonstrations.subsample(every, seed)
    assert subsampled.stride == every
    assert subsampled.observations.shape == (len(demonstrations.lengths), num_blocks, 2)
    np.testing.assert_array_equal(subsampled.returns, demonstrations.returns)
    np.testing.assert_array_equal(subsampled.actions[..., 0], subsampled.observations[..., 1])
    for number, length in enumerate(demonstrations.lengths):
        kept = subsampled.lengths[number]
        numbers, times = subsampled.observations[number, :kept].T
        assert (numbers == number).all()
        assert 0 <= times[0] < min(every, length)
        np.testing.assert_array_equal(times, times[0] + every * np.arange(kept))
        assert times[-1] < length
        # The last entry is followed by the end of the episode or the new time limit. An episode
        # that reached the old time limit reaches the new one.
        assert kept == num_blocks or times[-1] + every >= length
        if length >= num_blocks * every:
            assert kept == num_blocks


@given(clocks(), st.data())
def test_first_and_subsample_commute(drawn, data) -> None:
    demonstrations, every = drawn
    number = data.draw(st.integers(1, demonstrations.num_trajectories))
    first_then, then_first = (
        demonstrations.first(number).subsample(every),
        demonstrations.subsample(every).first(number),
    )
    np.testing.assert_array_equal(first_then.observations, then_first.observations)
    np.testing.assert_array_equal(first_then.lengths, then_first.lengths)


@pytest.mark.parametrize("length", [7, 12, 29, 30])
def test_one_in_k_steps_is_kept_on_average(length: int) -> None:
    num_episodes = 4000
    demonstrations = Demonstrations(
        observations=np.zeros((num_episodes, 30, 1), np.float32),
        actions=None,
        lengths=np.full(num_episodes, length),
        returns=np.zeros(num_episodes, np.float32),
        env_id="Clock",
    )
    kept = demonstrations.subsample(6).lengths
    assert kept.mean() == pytest.approx(length / 6, abs=4 * 0.5 / np.sqrt(num_episodes))


@pytest.mark.parametrize("every", [0, -1, 6])
def test_subsampling_needs_a_whole_block(every: int) -> None:
    with pytest.raises(UserError, match=r"from 1 to the time limit of the demonstrations, 5"):
        state_only().subsample(every)
