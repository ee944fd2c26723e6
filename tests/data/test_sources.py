"""Sources of demonstrations."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from ailsrs_jax.data.demonstrations import Demonstrations
from ailsrs_jax.data.episodes import Recording
from ailsrs_jax.data.sources import (
    Source,
    open_source,
    parse_source,
    require_target,
    save_recording,
)
from ailsrs_jax.errors import UserError
from tests.data.formats.test_imitation import trajectory, write


def swimmer_recording() -> Recording:
    rng = np.random.default_rng(0)
    rewards = rng.normal(size=(2, 5)).astype(np.float32)
    demonstrations = Demonstrations(
        observations=rng.normal(size=(2, 5, 8)).astype(np.float32),
        actions=rng.uniform(-1, 1, (2, 5, 2)).astype(np.float32),
        lengths=np.array([5, 5]),
        returns=rewards.sum(axis=1),
        env_id="Swimmer-v5",
    )
    return Recording(demonstrations, rewards, np.zeros((2, 8), np.float32))


@pytest.mark.parametrize("target", ["new/ours.npz", "minari:swimmer/ours-v0"])
def test_what_is_written_is_read(target: str, in_tmp_path: Path) -> None:
    if target.startswith("minari:"):
        pytest.importorskip("minari")
    recording = swimmer_recording()
    require_target(target, "Swimmer-v5")
    save_recording(recording, target)
    demonstrations, source = open_source(target, "Swimmer-v5")
    assert source.argument == str(source) == target
    assert parse_source(vars(source), "config.json") == source
    for name in ("observations", "actions", "lengths", "env_id"):
        np.testing.assert_array_equal(
            getattr(demonstrations, name), getattr(recording.demonstrations, name)
        )


def test_what_is_left_out_is_said(tmp_path: Path) -> None:
    pytest.importorskip("pyarrow")
    directory = write(tmp_path / "d", trajectory(), trajectory(3, terminal=False), trajectory())
    demonstrations, source = open_source(directory, "Swimmer-v5")
    assert demonstrations.num_trajectories == 2
    assert source == Source("imitation", str(directory), num_left_out=1)
    assert str(source) == f"{directory} (1 truncated episode left out)"
    assert open_source(str(directory), "Swimmer-v5", 1)[1] == Source("imitation", str(directory))


def test_what_is_nowhere(tmp_path: Path) -> None:
    for source, message in {
        tmp_path / "none.npz": "no such file",
        "x" * 300: "File name too long",
        tmp_path: "was not written by imitation.data.serialize.save",
    }.items():
        with pytest.raises(UserError, match=message):
            open_source(source, "Swimmer-v5")


def test_demonstrations_are_described() -> None:
    linear = "of the expert that ships with the package (expert:linear)"
    assert (
        Source("expert", "linear").described(1, 20) == f"1 demonstration {linear}, one step in 20"
    )
    assert Source("file", "mine.npz").described(2, 1) == "2 demonstrations mine.npz"


def test_the_argument_names_the_source() -> None:
    assert Source("expert").argument is None
    assert Source("expert", "paper").argument == "expert:paper"
    assert Source("minari", "mujoco/hopper/expert-v0").argument == "minari:mujoco/hopper/expert-v0"
    assert Source("file", "mine.npz").argument == "mine.npz"
    assert Source("memory").argument is None


@pytest.mark.parametrize(
    "source", [Source("expert"), Source("expert", "paper"), Source("memory"), Source("file", "a")]
)
def test_a_source_is_read_as_it_was_written(source: Source) -> None:
    assert parse_source(dataclasses.asdict(source), "config.json") == source


@pytest.mark.parametrize(
    "fields",
    [
        "mine.npz",
        {"kind": "web"},
        {"kind": "file"},
        {"kind": "file", "name": 3},
        {"kind": "file", "name": "a", "num_left_out": -1},
        {"kind": "file", "name": "a", "num_left_out": 2**40},
        {"kind": ["file"], "name": "a"},
        {"kind": "expert", "more": 1},
    ],
)
def test_a_damaged_source_is_one_line(fields: object) -> None:
    with pytest.raises(UserError, match=r"config\.json: source is .*, not a source of demonstr"):
        parse_source(fields, "config.json")
