"""Checkpoints on disks that fail and in processes that are killed."""

import logging
import os
import resource
import shutil
import subprocess
import time
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from ailsrs_jax.errors import UserError
from ailsrs_jax.runs.storage import checkpoint
from ailsrs_jax.runs.storage.checkpoint import HASHES, Checkpoints


def make_state(value: float = 0.0, size: int = 6) -> dict[str, Any]:
    return {
        "weights": jnp.full((2, size), float(value)),
        "key": jax.random.key(int(value)),
        "steps": np.array([2**40 + int(value)]),
    }


def write(directory: Path, *values: int) -> None:
    with Checkpoints(directory, 1) as checkpoints:
        for value in values:
            checkpoints.save(value, make_state(value))


def read(directory: Path) -> tuple[int, float]:
    """Return the iterations done and the number in the state, which should be equal."""
    with Checkpoints(directory, 1) as checkpoints:
        num_done, state, _ = checkpoints.restore(make_state())
    assert int(state["steps"][0]) - 2**40 == jax.random.key_data(state["key"])[-1] == num_done
    return num_done, float(state["weights"][1, 1])


@pytest.fixture(scope="module")
def three(tmp_path_factory: pytest.TempPathFactory) -> Path:
    directory = tmp_path_factory.mktemp("three")
    write(directory, 1, 2, 3)
    return directory


@pytest.fixture
def copy(three: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(three, tmp_path / "copy"))


def test_the_last_two_are_kept_and_can_be_checked_by_hand(three: Path) -> None:
    assert sorted(path.name for path in three.iterdir()) == ["2", "3"]
    check = ["sha256sum", "--check", "--strict", "--quiet", HASHES]
    assert subprocess.run(check, cwd=three / "3", check=False).returncode == 0
    assert read(three) == (3, 3.0)


def damages(directory: Path) -> dict[str, Any]:
    """Return functions without arguments that each damage a checkpoint in one way."""
    files = [path for path in sorted(directory.rglob("*")) if path.is_file()]
    assert len(files) > 10

    def flip(path: Path) -> None:
        content = bytearray(path.read_bytes())
        content[len(content) // 2] ^= 4
        path.write_bytes(bytes(content))

    def truncate(path: Path) -> None:
        path.write_bytes(path.read_bytes()[:-1])

    ways = [flip, truncate, lambda path: path.write_bytes(b""), Path.unlink]
    found = {}
    for index, path in enumerate(path for path in files if path.stat().st_size):
        way = ways[index % len(ways)]
        if path.name == HASHES:
            way = flip  # without hashes the checkpoint would count as unfinished
        found[str(path)] = lambda path=path, way=way: way(path)
    return found


def test_a_damaged_file_of_the_newest_is_noticed(
    three: Path, tmp_path: Path, caplog, capfd
) -> None:
    """Damage to any file in any way means one warning, and the previous checkpoint is used."""
    for number in range(len(damages(three / "3"))):
        copy = Path(shutil.copytree(three, tmp_path / str(number)))
        list(damages(copy / "3").values())[number]()
        caplog.clear()
        assert read(copy) == (2, 2.0)
        (record,) = caplog.records
        assert record.getMessage() == f"checkpoint 3 in {copy} is damaged: resuming from 2"
        write(copy, 3)  # as the resumed run does
        assert read(copy) == (3, 3.0)
    assert capfd.readouterr().err == ""


def test_none_that_can_be_read_is_an_error_and_nothing_is_removed(copy: Path, capfd) -> None:
    for number in (2, 3):
        (copy / str(number) / HASHES).write_text("")
    with pytest.raises(UserError, match="delete them to start over"):
        read(copy)
    assert sorted(path.name for path in copy.iterdir()) == ["2", "3"]
    assert capfd.readouterr().err == ""


def test_hashes_in_a_pipe_are_not_waited_for(copy: Path) -> None:
    (copy / "3" / HASHES).unlink()
    os.mkfifo(copy / "3" / HASHES)
    assert read(copy) == (2, 2.0)


def test_one_that_was_never_finished_is_passed_over(copy: Path, caplog) -> None:
    (copy / "3" / HASHES).unlink()
    (copy / "4.orbax-checkpoint-tmp").mkdir()
    assert read(copy) == (2, 2.0)
    assert sorted(path.name for path in copy.iterdir()) == ["2"]
    (copy / "2" / HASHES).unlink()
    with Checkpoints(copy, 1) as checkpoints:
        assert checkpoints.restore(make_state()).num_done == 0
    assert not list(copy.iterdir())
    assert not caplog.records


def test_one_that_was_never_finished_is_finished_by_saving_the_same_again(copy: Path) -> None:
    (copy / "3" / HASHES).unlink()
    write(copy, 3)
    assert read(copy) == (3, 3.0)


@pytest.mark.parametrize(
    "other",
    [
        make_state(size=7),
        {**make_state(), "weights": jnp.zeros((2, 6), jnp.int32)},
        {**make_state(), "more": np.zeros(1)},
        {"weights": make_state()["weights"]},
    ],
    ids=["size", "type", "more", "fewer"],
)
def test_whoever_has_another_state_is_told(other: dict[str, Any], copy: Path, capfd) -> None:
    with Checkpoints(copy, 1) as checkpoints, pytest.raises(UserError, match="has other arrays"):
        checkpoints.restore(other)
    assert capfd.readouterr().err == ""


def test_numbers_tell_the_newest_whatever_the_clock_says(tmp_path: Path, monkeypatch) -> None:
    now = iter(range(10**9, 0, -1000))
    monkeypatch.setattr(time, "time", lambda: float(next(now)))
    monkeypatch.setattr(time, "time_ns", lambda: next(now) * 10**9)
    write(tmp_path, 8, 9, 10)
    for age, path in enumerate(sorted(tmp_path.iterdir(), key=lambda path: int(path.name))):
        os.utime(path, (10**9 - 10**6 * age,) * 2)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["10", "9"]
    assert read(tmp_path) == (10, 10.0)


def test_by_default_every_tenth_iteration_is_saved_but_not_within_a_second(
    tmp_path: Path, monkeypatch
) -> None:
    """And at most a tenth of the time is spent on it."""
    now = 0.0
    monkeypatch.setattr(time, "monotonic", lambda: now)
    with Checkpoints(tmp_path) as checkpoints:
        assert checkpoints.is_due(1)
        checkpoints.save(1, make_state())
        for seconds, until in ((0.01, 1.0), (2.0, 18.0)):
            began, now = now, now + seconds
            checkpoints.rest(began)
            now += until - 0.1
            assert not checkpoints.is_due(10)
            now += 0.2
            assert not checkpoints.is_due(19)
            assert checkpoints.is_due(20)
        monkeypatch.setattr(checkpoint, "anywhere", lambda resting: True)
        assert not checkpoints.is_due(20)  # another process rests


@pytest.fixture
def small_files() -> Any:
    """Limit files to 2 kB."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (2000, hard))
    yield
    resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


@pytest.fixture
def unforeseen(small_files, monkeypatch) -> None:
    """Writing fails in the middle of a file, as on a disk that others fill meanwhile."""
    monkeypatch.setattr(checkpoint, "OVERHEAD", -80_000)  # the size of the arrays


def write_noise(directory: Path, *values: int, then: BaseException | None = None) -> None:
    state = {"noise": np.random.default_rng(0).normal(size=10_000)}
    with Checkpoints(directory, 1) as checkpoints:
        for value in values:
            checkpoints.save(value, state)
        if then is not None:
            raise then


@pytest.mark.parametrize(
    "values", [(1,), (1, 2)]
)  # the error is noticed at the end, or at the next save
def test_what_cannot_be_written_is_told(unforeseen, values: tuple[int, ...], tmp_path) -> None:
    with pytest.raises(UserError, match=r"cannot write .*: File too large"):
        write_noise(tmp_path, *values)


def test_an_error_on_its_way_is_not_hidden_by_another(unforeseen, tmp_path: Path, caplog) -> None:
    with pytest.raises(KeyError, match="mine"):
        write_noise(tmp_path, 1, then=KeyError("mine"))
    (record,) = caplog.records
    assert record.getMessage() == f"cannot write {tmp_path}: File too large"


def test_who_interrupts_is_told_that_it_could_not_be_saved(unforeseen, tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"cannot write .*: File too large"):
        write_noise(tmp_path, 1, then=KeyboardInterrupt())


def test_a_limit_of_files_is_foreseen(small_files, tmp_path: Path, capfd) -> None:
    with pytest.raises(UserError, match=r"cannot write .*: File too large"):
        write_noise(tmp_path, 1)
    assert list(tmp_path.iterdir()) == []
    assert capfd.readouterr().err == ""


def test_what_no_disk_holds_is_not_begun(tmp_path: Path, capfd) -> None:
    write(tmp_path, 1)
    endless = {"noise": np.broadcast_to(np.zeros(1), 10**17)}  # of eight bytes in memory
    with (
        Checkpoints(tmp_path, 1) as checkpoints,
        pytest.raises(UserError, match="No space left on device"),
    ):
        checkpoints.save(2, endless)
    assert read(tmp_path) == (1, 1.0)
    assert capfd.readouterr().err == ""


@pytest.mark.skipif(os.getuid() != 0, reason="only root can mount a small disk")
def test_a_full_disk_is_foreseen(tmp_path: Path, capfd) -> None:
    mount = ["mount", "-t", "tmpfs", "-o", "size=1m", "tmpfs", str(tmp_path)]
    if subprocess.run(mount, check=False, capture_output=True).returncode:
        pytest.skip("not in this container")
    try:
        write(tmp_path, 1)
        (tmp_path / "others").write_bytes(bytes(800_000))
        with pytest.raises(UserError, match="No space left on device"):
            write(tmp_path, 2)
        (tmp_path / "others").unlink()
        assert read(tmp_path) == (1, 1.0)
    finally:
        subprocess.run(["umount", str(tmp_path)], check=True)
    assert capfd.readouterr().err == ""


def test_where_nothing_can_be_written(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(UserError, match="cannot write"):
        Checkpoints(tmp_path / "file" / "checkpoints", 1)


def test_from_one_device_to_two_and_back(tmp_path: Path) -> None:
    def placed(num_devices: int, steps: np.ndarray) -> dict[str, Any]:
        mesh = Mesh(np.array(jax.devices()[:num_devices]), ("directions",))
        shard = NamedSharding(mesh, PartitionSpec("directions"))
        everywhere = NamedSharding(mesh, PartitionSpec())
        return {
            "steps": jax.device_put(steps, shard),
            "key": jax.device_put(jax.random.key(7), everywhere),
        }

    steps = np.random.default_rng(0).normal(size=(4, 3)).astype(np.float32)
    state = placed(1, steps)
    for num_done, num_devices in enumerate((2, 1, 4), start=1):
        with Checkpoints(tmp_path, 1) as checkpoints:
            checkpoints.save(num_done, state)
        with Checkpoints(tmp_path, 1) as checkpoints:
            state = checkpoints.restore(placed(num_devices, 0 * steps)).state
        assert len(state["steps"].sharding.device_set) == num_devices
        np.testing.assert_array_equal(state["steps"], steps)
        np.testing.assert_array_equal(*map(jax.random.key_data, (state["key"], jax.random.key(7))))


def test_orbax_may_log_again_afterwards(three: Path) -> None:
    level = logging.getLogger("absl").level
    read(three)
    assert logging.getLogger("absl").level == level
