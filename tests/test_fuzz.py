"""Every reader gives a value or one line for any file; ``python -m tests.fuzz`` tries more."""

import os
import pickle
import shutil
import time
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from ailsrs_jax.errors import UserError
from tests.fuzz.readers import READERS
from tests.fuzz.watcher import Watcher, limited_memory

SCALE = int(os.environ.get("FUZZ_SCALE", "1"))
CPU_SECONDS = 20  # for one file


@pytest.fixture(scope="module")
def watcher(tmp_path_factory: pytest.TempPathFactory) -> Watcher:
    return Watcher(tmp_path_factory.getbasetemp())


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("name", READERS)
def test_damaged_files_give_a_value_or_one_line(
    name: str, watcher: Watcher, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    reader = READERS[name]
    pytest.importorskip(reader.package)
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "datasets"))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    directory = tmp_path / "directory"
    outcomes = set()

    @settings(
        max_examples=SCALE * reader.inputs,
        deadline=None,
        derandomize=SCALE == 1,
        database=None,
        suppress_health_check=list(HealthCheck),
    )
    @given(st.data())
    def read_one(data: st.DataObject) -> None:
        # Removed before and not after, so that the last failing file stays.
        shutil.rmtree(directory, ignore_errors=True)
        directory.mkdir()
        monkeypatch.chdir(directory)
        reader.make(data.draw, directory / "input")
        started = time.process_time()
        try:
            with watcher.watch():
                reader.read(directory / "input")
            outcomes.add("value")
        except UserError as error:
            outcomes.add("refused")
            text = str(error)
            assert text.isprintable()
            assert 0 < len(text) <= 1000
        assert not watcher.events
        assert time.process_time() - started < CPU_SECONDS

    with limited_memory():
        read_one()
    assert "value" in outcomes  # otherwise the damage would always be noticed early
    assert {path.name for path in tmp_path.iterdir()} <= {"datasets", "cache", "directory"}


def test_the_watcher_notices_side_effects(watcher: Watcher, tmp_path: Path) -> None:
    class Harmful:
        def __reduce__(self) -> tuple:
            return (os.system, ("true",))

    harmful, outside = pickle.dumps(Harmful()), Path("/tmp/a-place-outside")
    for act in (
        lambda: pickle.loads(harmful),
        lambda: outside.write_text(""),
        lambda: os.system("true"),
    ):
        with watcher.watch():
            act()
        assert watcher.events
    outside.unlink()
    with watcher.watch():
        (tmp_path / "inside").write_text("")
    assert not watcher.events


def test_the_memory_limit_is_noticed() -> None:
    with limited_memory(), pytest.raises(MemoryError):
        bytearray(2**36)
