"""A small slice of ``python -m tests.fuzz``: whatever the bytes, a value or one line."""

from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests.fuzz.machinery import Watcher, try_one
from tests.fuzz.readers import READERS, Reader

# In proportion to what each costs; a second or less altogether.
EXAMPLES = {
    "demonstrations": 150,
    "policy": 150,
    "safetensors": 100,
    "config": 80,
    "model card": 60,
    "metrics": 60,
    "run": 60,
    "results": 60,
    "sweep spec": 30,
    "sweep": 60,
    "imitation": 60,
    "minari": 20,
    "checkpoints": 4,
}


@pytest.fixture(scope="module")
def watcher(tmp_path_factory: pytest.TempPathFactory) -> Watcher:
    return Watcher(tmp_path_factory.getbasetemp())


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("name", READERS)
def test_whatever_the_bytes(
    name: str, watcher: Watcher, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if name == "imitation":
        pytest.importorskip("pyarrow")
    elif name in ("minari", "safetensors"):
        pytest.importorskip(name)
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "datasets"))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.chdir(tmp_path)

    outcomes = set()

    @settings(
        max_examples=EXAMPLES[name],
        deadline=None,
        derandomize=True,
        database=None,
        suppress_health_check=[HealthCheck.too_slow],
    )
    @given(st.integers(0, 2**32))
    def gives_a_value_or_one_line(number: int) -> None:
        outcome, text = try_one(READERS[name], tmp_path / "input", f"{name} {number}", watcher)
        assert outcome in ("value", "refused"), text
        outcomes.add(outcome)

    gives_a_value_or_one_line()
    assert "value" in outcomes  # or what it makes is refused before it is read
    assert {path.name for path in tmp_path.iterdir()} <= {"datasets", "cache"}


def test_the_watcher_sees_what_it_should(watcher: Watcher, tmp_path: Path) -> None:
    """Or its silence would mean nothing."""
    import os
    import pickle

    class Harmful:
        def __reduce__(self) -> tuple:
            return (os.system, ("true",))

    harmful = pickle.dumps(Harmful())
    for act in (
        lambda path: pickle.loads(harmful),
        lambda path: Path("/tmp/a-place-outside").write_text(""),
        lambda path: os.system("true"),
    ):
        reader = Reader(1, lambda path, rng: None, act)
        assert try_one(reader, tmp_path / "none", "", watcher)[0] == "outside"
    Path("/tmp/a-place-outside").unlink()
    for act, outcome in {
        (lambda path: 1 / 0): "traceback",
        (lambda path: (tmp_path / "inside").write_text("")): "value",
    }.items():
        reader = Reader(1, lambda path, rng: None, act)
        assert try_one(reader, tmp_path / "none", "", watcher)[0] == outcome
