"""Datasets that Minari itself wrote, in a temporary directory."""

import contextlib
import dataclasses
import json
import sys
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest

from ailsrs_jax.data.demonstrations import Demonstrations
from ailsrs_jax.data.episodes import Recording, load_minari, save_minari
from ailsrs_jax.errors import UserError

minari = pytest.importorskip("minari")
HDF5Storage = pytest.importorskip("minari.dataset._storages.hdf5_storage").HDF5Storage

TIME_LIMIT = 10


@pytest.fixture(autouse=True)
def datasets(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    return tmp_path


def hopper_recording() -> Recording:
    rng = np.random.default_rng(0)
    lengths = np.array([10, 4, 7])
    alive = np.arange(TIME_LIMIT) < lengths[:, None]
    rewards = np.where(alive, rng.normal(size=(3, TIME_LIMIT)), 0.0).astype(np.float32)
    observations = rng.normal(size=(3, TIME_LIMIT, 11)).astype(np.float32)
    actions = rng.uniform(-1, 1, (3, TIME_LIMIT, 3)).astype(np.float32)
    demonstrations = Demonstrations(
        observations=np.where(alive[..., None], observations, 0.0),
        actions=np.where(alive[..., None], actions, 0.0),
        lengths=lengths,
        returns=rewards.sum(axis=1),
        env_id="Hopper-v5",
    )
    return Recording(demonstrations, rewards, rng.normal(size=(3, 11)).astype(np.float32))


def test_a_saved_dataset_is_loaded_unchanged() -> None:
    recording = hopper_recording()
    save_minari(recording, "hopper/ours-v0")
    loaded, num_left_out = load_minari("hopper/ours-v0", "Hopper-v5")
    assert num_left_out == 0
    assert loaded.env_id == "Hopper-v5"
    ours = recording.demonstrations
    for name in ("observations", "actions", "lengths"):
        np.testing.assert_array_equal(getattr(loaded, name), getattr(ours, name))
    np.testing.assert_allclose(loaded.returns, ours.returns, rtol=1e-6)

    dataset = minari.load_dataset("hopper/ours-v0")
    assert dataset.env_spec.id == "Hopper-v5"
    assert dataset.env_spec.max_episode_steps == TIME_LIMIT
    assert "author" not in dataset.storage.metadata
    env = gymnasium.make("Hopper-v5")
    assert dataset.observation_space == env.observation_space
    assert dataset.action_space == env.action_space
    for index, episode in enumerate(dataset.iterate_episodes()):
        length = ours.lengths[index]
        assert episode.observations.shape == (length + 1, 11)
        np.testing.assert_array_equal(episode.observations[-1], recording.final_observations[index])
        np.testing.assert_array_equal(episode.rewards, recording.env_rewards[index, :length])
        assert not episode.terminations[:-1].any()
        assert not episode.truncations[:-1].any()
        assert (episode.terminations[-1], episode.truncations[-1]) == (index != 0, index == 0)


def test_a_dataset_of_your_own_task() -> None:
    recording = hopper_recording()
    ours = recording.demonstrations.replace(env_id="my_tasks:Hopper")
    save_minari(dataclasses.replace(recording, demonstrations=ours), "own/hopper-v0")
    loaded, num_left_out = load_minari("own/hopper-v0", "my_tasks:Hopper")
    assert num_left_out == 0
    for name in ("observations", "actions", "lengths"):
        np.testing.assert_array_equal(getattr(loaded, name), getattr(ours, name))
    for other in ("my_tasks:Slider", "Hopper-v5"):
        with pytest.raises(UserError, match=f"is of my_tasks:Hopper, not of {other}"):
            load_minari("own/hopper-v0", other)


def test_a_dataset_that_names_no_environment() -> None:
    """It can be of your own task, and has no time limit."""
    box = gymnasium.spaces.Box(-1, 1, (2,))
    episode = minari.data_collector.EpisodeBuffer(
        observations=np.zeros((4, 2), np.float32),
        actions=np.ones((3, 2), np.float32),
        rewards=np.ones(3, np.float32),
        terminations=[False, False, True],
        truncations=[False] * 3,
    )
    create("own/slider-v0", episode, observation_space=box, action_space=box)
    loaded, num_left_out = load_minari("own/slider-v0", "my_tasks:Slider")
    assert (loaded.env_id, num_left_out) == ("my_tasks:Slider", 0)
    assert loaded.observations.shape == (1, 6, 2)
    with pytest.raises(UserError, match="does not name its environment"):
        load_minari("own/slider-v0", "Hopper-v5")


def test_only_the_first_episodes_are_read() -> None:
    save_minari(hopper_recording(), "hopper/ours-v0")
    loaded, _ = load_minari("hopper/ours-v0", "Hopper-v5", num_trajectories=2)
    assert loaded.lengths.tolist() == [10, 4]


def episode(length: int = TIME_LIMIT, *, terminated: bool = False, **changes: Any) -> Any:
    is_last = np.arange(length) == length - 1
    arrays = {
        "observations": np.zeros((length + 1, 11)),
        "actions": np.zeros((length, 3), np.float32),
        "rewards": np.ones(length),
        "terminations": is_last & terminated,
        "truncations": is_last & (not terminated),
    }
    return minari.data_collector.EpisodeBuffer(**(arrays | changes))


def write(*episodes: Any, env: Any = None, dataset_id: str = "hopper/test-v0", **more: Any) -> None:
    env = env or gymnasium.make("Hopper-v5", max_episode_steps=TIME_LIMIT)
    create(dataset_id, *episodes, env=env, **more)


def create(dataset_id: str, *episodes: Any, **options: Any) -> None:
    with warnings.catch_warnings(action="ignore"):
        minari.create_dataset_from_buffers(dataset_id, list(episodes), **options)


def test_cut_off_episodes_are_left_out() -> None:
    write(episode(6), episode(), episode(3, terminated=True), episode(9))
    loaded, num_left_out = load_minari("hopper/test-v0", "Hopper-v5")
    assert loaded.lengths.tolist() == [10, 3]
    assert loaded.observations.shape == (2, TIME_LIMIT, 11)
    assert num_left_out == 2


def test_an_absurd_time_limit_is_ignored() -> None:
    env = gymnasium.make("Hopper-v5", max_episode_steps=10**9)
    episodes = (episode(5, terminated=True), episode(9), episode(6, terminated=True))
    write(*episodes, env=env)
    for number in (1, 2):  # the time limit is the same
        loaded, num_left_out = load_minari("hopper/test-v0", "Hopper-v5", number)
        assert loaded.lengths.tolist() == [5, 6][:number]
        assert loaded.observations.shape == (number, 12, 11)
        assert num_left_out == number - 1


def with_nan() -> np.ndarray:
    observations = np.zeros((TIME_LIMIT + 1, 11))
    observations[3, 3] = np.nan
    return observations


WRONG = {
    "is of Walker2d-v5, not of Hopper-v5": lambda: write(
        env=gymnasium.make("Walker2d-v5", max_episode_steps=TIME_LIMIT)
    ),
    "is of Hopper-v5 with healthy_reward=2.0: it must": lambda: write(
        episode(), env=gymnasium.make("Hopper-v5", healthy_reward=2.0)
    ),
    "with exclude_current_positions_from_observation=False": lambda: write(
        env=gymnasium.make("Hopper-v5", exclude_current_positions_from_observation=False)
    ),
    "with NormalizeObservation: it must": lambda: write(
        episode(), env=gymnasium.wrappers.NormalizeObservation(gymnasium.make("Hopper-v5"))
    ),
    "does not name its environment": lambda: write_without_environment(),
    "its observation_space is Dict": lambda: write(
        observation_space=gymnasium.spaces.Dict({"position": gymnasium.spaces.Box(-1, 1)})
    ),
    "its action_space is Discrete(3)": lambda: write(action_space=gymnasium.spaces.Discrete(3)),
    "holds no whole episode: 0 are cut off": lambda: write(),
    "holds no whole episode: 1 are cut off": lambda: write(episode(5)),
    "observations hold NaN or infinity": lambda: write(episode(observations=with_nan())),
    "actions hold NaN or infinity": lambda: write(
        episode(actions=np.full((TIME_LIMIT, 3), np.inf, np.float32))
    ),
    "episode 1: observations (10, 11), actions (10, 3)": lambda: write(
        episode(), episode(observations=np.zeros((TIME_LIMIT, 11)))
    ),
    "episode 0: rewards are int64, not floating": lambda: write(
        episode(rewards=np.ones(TIME_LIMIT, int))
    ),
    "differ: [(11, 3), (12, 3)]": lambda: write(
        episode(), episode(observations=np.zeros((TIME_LIMIT + 1, 12)))
    ),
    "has 11 steps, more than the time limit, 10": lambda: write(episode(11, terminated=True)),
}


def write_without_environment() -> None:
    env = gymnasium.make("Hopper-v5")
    spaces = {"observation_space": env.observation_space, "action_space": env.action_space}
    create("hopper/test-v0", episode(), **spaces)


@pytest.mark.parametrize("message", WRONG)
def test_mistakes_are_named(message: str) -> None:
    WRONG[message]()
    with pytest.raises(UserError) as caught:
        load_minari("hopper/test-v0", "Hopper-v5")
    assert message in str(caught.value)
    assert str(caught.value).startswith("minari:hopper/test-v0")


@pytest.mark.parametrize("name", ["main_data.hdf5", "metadata.json"])
@pytest.mark.parametrize("share", [0.0, 0.3, 0.7, 0.99])
def test_damage_is_refused(name: str, share: float, datasets: Path) -> None:
    write(episode(), episode(4, terminated=True))
    (path,) = datasets.rglob(name)
    content = path.read_bytes()
    path.write_bytes(content[: int(share * len(content))])
    with pytest.raises(UserError):
        load_minari("hopper/test-v0", "Hopper-v5")


def test_code_that_a_dataset_names_is_not_run(datasets: Path) -> None:
    """Minari makes the environment of a dataset that does not define the spaces."""
    write(episode())
    (path,) = datasets.rglob("metadata.json")
    metadata = json.loads(path.read_text())
    spec = json.loads(metadata["env_spec"])
    spec |= {"entry_point": "os:mkdir", "kwargs": {"path": str(datasets / "made")}}
    spec |= {"max_episode_steps": None, "order_enforce": False, "disable_env_checker": True}
    metadata["env_spec"] = json.dumps(spec)
    del metadata["observation_space"]
    path.write_text(json.dumps(metadata))
    with pytest.raises(UserError, match="does not define its observation_space"):
        load_minari("hopper/test-v0", "Hopper-v5")
    assert not (datasets / "made").exists()
    with contextlib.suppress(Exception):  # Gymnasium refuses the environment afterwards
        minari.load_dataset("hopper/test-v0")
    assert (datasets / "made").exists()  # so the danger is real


def change_data(datasets: Path, change: Callable[[Any], None]) -> None:
    import h5py

    (path,) = datasets.rglob("main_data.hdf5")
    with h5py.File(path, "a") as file:
        del file["episode_0"]["rewards"]
        change(file["episode_0"])


def test_links_and_bombs_are_refused(datasets: Path) -> None:
    h5py = pytest.importorskip("h5py")
    outside = [(str(datasets / "raw"), 0, h5py.h5f.UNLIMITED)]
    layout = h5py.VirtualLayout(shape=(10,), dtype="f4")
    layout[:] = h5py.VirtualSource(str(datasets / "other.hdf5"), "x", shape=(10,))
    for message, change in {
        "holds a link: 'episode_0/rewards'": lambda group: group.update(
            rewards=h5py.ExternalLink(str(datasets / "other.hdf5"), "/x")
        ),
        "points to other files: 'episode_0/rewards'": lambda group: group.create_dataset(
            "rewards", (10,), "f4", external=outside
        ),
        "has several names for 'episode_0/": lambda group: group.update(again=group["actions"]),
        "points to other files": lambda group: group.create_virtual_dataset("rewards", layout),
        "would grow from": lambda group: group.create_dataset(
            "rewards", (10**12,), "f4", chunks=(1024,)
        ),
    }.items():
        write(episode())
        change_data(datasets, change)
        with pytest.raises(UserError) as caught:
            load_minari("hopper/test-v0", "Hopper-v5")
        assert message in str(caught.value)
        minari.delete_dataset("hopper/test-v0")


@pytest.mark.parametrize(
    ("message", "change"),
    [
        ("not in the format hdf5", {"data_format": "arrow"}),
        ("does not hold the number of episodes", {"total_episodes": 10**12}),
    ],
)
def test_false_metadata_is_refused(message: str, change: dict, datasets: Path) -> None:
    write(episode())
    (path,) = datasets.rglob("metadata.json")
    path.write_text(json.dumps(json.loads(path.read_text()) | change))
    with pytest.raises(UserError, match=message):
        load_minari("hopper/test-v0", "Hopper-v5")
    with pytest.raises(UserError, match=r"cannot load minari:\.\./test-v0: ValueError: Malformed"):
        load_minari("../test-v0", "Hopper-v5")


def test_a_missing_dataset(monkeypatch: pytest.MonkeyPatch) -> None:
    def unreachable(dataset_id: str) -> None:
        raise ConnectionError("no route\nto the server")

    monkeypatch.setattr(minari, "download_dataset", unreachable)
    with pytest.raises(UserError, match=r"cannot load minari:hopper/none-v0: .*: no route$"):
        load_minari("hopper/none-v0", "Hopper-v5")


def test_without_minari(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "minari", None)
    for call in (
        lambda: load_minari("hopper/test-v0", "Hopper-v5"),
        lambda: save_minari(hopper_recording(), "hopper/test-v0"),
    ):
        with pytest.raises(UserError, match=r"pip install 'ailsrs_jax\[minari\]'"):
            call()


def test_datasets_that_cannot_be_made(datasets: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full_disk(*_: Any) -> None:
        raise OSError("disk full")

    recording = hopper_recording()
    save_minari(recording, "hopper/ours-v0")
    own, states_alone = (
        dataclasses.replace(recording, demonstrations=recording.demonstrations.replace(**change))
        for change in ({"env_id": "PointMass"}, {"actions": None})
    )
    for message, call in {
        "hopper/ours-v0 exists": lambda: save_minari(recording, "hopper/ours-v0"),
        "hopper v0 is not the name of a Minari dataset": lambda: save_minari(
            recording, "hopper v0"
        ),
        "use one like hopper/mine-v0": lambda: save_minari(recording, "hopper"),
        "needs the action of every step": lambda: save_minari(states_alone, "hopper/other-v0"),
        "not PointMass: write a .npz": lambda: save_minari(own, "hopper/other-v0"),
    }.items():
        with pytest.raises(UserError) as caught:
            call()
        assert message in str(caught.value)
    monkeypatch.setattr(HDF5Storage, "update_episodes", full_disk)
    with pytest.raises(UserError, match="cannot write minari:hopper/next-v0: OSError: disk full"):
        save_minari(recording, "hopper/next-v0")
    assert [path.name for path in (datasets / "hopper").glob("*-v0")] == ["ours-v0"]
    monkeypatch.setenv("MINARI_DATASETS_PATH", "/proc/none")
    with pytest.raises(UserError, match="cannot write minari:hopper/next-v0: No such file"):
        save_minari(recording, "hopper/next-v0")
