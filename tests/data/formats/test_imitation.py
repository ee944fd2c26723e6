"""Directories like those of ``imitation.data.serialize.save``, written with Arrow only."""

import json
import pickle
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ailsrs_jax.data.episodes import load_imitation
from ailsrs_jax.data.formats.imitation import require_no_pickle
from ailsrs_jax.errors import UserError

pyarrow = pytest.importorskip("pyarrow")

ARROW_FILE = "data-00000-of-00001.arrow"


def trajectory(length: int = 4, *, terminal: bool = True, **changes: Any) -> dict[str, Any]:
    rng = np.random.default_rng(length)
    fields = {
        "obs": rng.normal(size=(length + 1, 8)).tolist(),
        "acts": rng.uniform(-1, 1, (length, 2)).tolist(),
        "infos": ["{}"] * length,
        "terminal": terminal,
        "rews": rng.normal(size=length).tolist(),
    }
    return fields | changes


def write(directory: Path, *trajectories: dict[str, Any], leave_out: tuple[str, ...] = ()) -> Path:
    names = [name for name in trajectory() if name not in leave_out]
    table = pyarrow.table({name: [row[name] for row in trajectories] for name in names})
    directory.mkdir(exist_ok=True)
    with pyarrow.ipc.new_stream(str(directory / ARROW_FILE), table.schema) as file:
        file.write_table(table)
    state = {"_data_files": [{"filename": ARROW_FILE}], "_split": None}
    (directory / "state.json").write_text(json.dumps(state))
    return directory


def test_whole_episodes_are_read(tmp_path: Path) -> None:
    rows = [trajectory(6), trajectory(3, terminal=False), trajectory(4)]
    demonstrations, num_left_out = load_imitation(write(tmp_path / "d", *rows), "Swimmer-v5")
    assert num_left_out == 1
    assert demonstrations.env_id == "Swimmer-v5"
    assert demonstrations.observations.shape == (2, 6, 8)
    assert demonstrations.lengths.tolist() == [6, 4]
    for index, row in enumerate((rows[0], rows[2])):
        length = len(row["acts"])
        np.testing.assert_array_equal(
            demonstrations.observations[index, :length], np.float32(row["obs"][:-1])
        )
        np.testing.assert_array_equal(
            demonstrations.actions[index, :length], np.float32(row["acts"])
        )
        assert demonstrations.returns[index] == pytest.approx(sum(row["rews"]), rel=1e-5)
    few, num_left_out = load_imitation(tmp_path / "d", "Swimmer-v5", num_trajectories=1)
    assert few.lengths.tolist() == [6]
    assert num_left_out == 0


def test_the_time_limit_does_not_depend_on_the_number_that_is_asked_for(tmp_path: Path) -> None:
    """Otherwise the fall after 4 steps would count as reaching the time limit."""
    rows = [trajectory(3), trajectory(4), trajectory(9, terminal=False), trajectory(7)]
    directory = write(tmp_path / "d", *rows)
    for number in (1, 2, 3):
        demonstrations, num_left_out = load_imitation(directory, "Swimmer-v5", number)
        assert demonstrations.observations.shape == (number, 7, 8)
        assert num_left_out == (number == 3)


def test_infos_are_never_decoded(tmp_path: Path) -> None:
    bomb = json.dumps({"py/reduce": [{"py/function": "os.abort"}, {"py/tuple": []}]})
    directory = write(tmp_path / "d", trajectory(infos=[bomb] * 4))
    demonstrations, _ = load_imitation(directory, "Swimmer-v5")
    assert demonstrations.lengths.tolist() == [4]


WRONG: dict[str, list[dict[str, Any]]] = {
    "holds no whole episode: 0 are cut off": [],
    "holds no whole episode: 1 are cut off": [trajectory(terminal=False)],
    "trajectory 1: observations (4, 8), actions (4, 2)": [
        trajectory(),
        trajectory(obs=np.zeros((4, 8)).tolist()),
    ],
    "trajectory 0: observations (5,), actions": [trajectory(obs=[[0.0] * n for n in range(5)])],
    "trajectory 0: observations (5,), actions (4, 2)": [trajectory(obs=[0.0] * 5)],
    "actions () and rewards (4,)": [trajectory(acts=None)],
    "actions are int64, not floating": [trajectory(acts=[[1, 2]] * 4)],
    "observations hold NaN or infinity": [trajectory(obs=[[float("nan")] * 8] * 5)],
    "rewards (3,) are not": [trajectory(rews=[1.0] * 3)],
    "terminal is neither true nor false": [trajectory(terminal=None)],
    "differ: [(7, 2), (8, 2)]": [trajectory(), trajectory(obs=[[0.0] * 7] * 5)],
}


@pytest.mark.parametrize("message", WRONG)
def test_mistakes_are_named(message: str, tmp_path: Path) -> None:
    refused(write(tmp_path / "d", *WRONG[message]), message)


def refused(directory: Path, message: str = "") -> None:
    with pytest.raises(UserError) as caught:
        load_imitation(directory, "Swimmer-v5")
    assert message in str(caught.value)
    assert str(caught.value).startswith(str(directory))


def test_other_directories_are_refused(tmp_path: Path) -> None:
    refused(tmp_path, "was not written by imitation.data.serialize.save")
    refused(write(tmp_path / "a", trajectory(), leave_out=("rews", "obs")), "has no obs, rews")
    write(tmp_path / "twice", trajectory())
    named = json.dumps({"_data_files": [{"filename": ARROW_FILE}] * 2})
    (tmp_path / "twice" / "state.json").write_text(named)
    refused(tmp_path / "twice", "no state.json that names its files")
    (write(tmp_path / "b", trajectory()) / ARROW_FILE).unlink()
    refused(tmp_path / "b", f"has no file {ARROW_FILE}")
    for content in ("", "[]", "{}", '{"_data_files": 3}', '{"_data_files": [{"filename": 3}]}'):
        (tmp_path / "b" / "state.json").write_text(content)
        refused(tmp_path / "b", "no state.json that names its files")


def test_older_formats_are_never_unpickled(tmp_path: Path) -> None:
    marker = tmp_path / "executed"

    class Malicious:
        def __reduce__(self) -> tuple:
            return (open, (str(marker), "w"))

    (tmp_path / "old.pkl").write_bytes(pickle.dumps(Malicious()))
    infos = np.array([Malicious()], dtype=object)
    np.savez(tmp_path / "old.npz", obs=np.zeros((2, 8)), acts=np.zeros((1, 2)), infos=infos)
    for name in ("old.pkl", "old.npz"):
        with pytest.raises(UserError) as caught:
            require_no_pickle(tmp_path / name)
        assert "serialize.save('DIRECTORY', serialize.load(" in str(caught.value)
    assert not marker.exists()


def test_other_files_are_not_refused(tmp_path: Path) -> None:
    (tmp_path / "text").write_text("observations")
    (tmp_path / "half.npz").write_bytes(b"PK\x03\x04")
    np.savez(tmp_path / "ours.npz", observations=np.zeros((1, 1, 1)))
    for name in ("text", "half.npz", "ours.npz", "none"):
        require_no_pickle(tmp_path / name)


def test_without_pyarrow(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(UserError, match=r"pip install 'ailsrs_jax\[imitation\]'"):
        load_imitation(tmp_path, "Swimmer-v5")
