"""The trackers' own clients, offline, if they are installed."""

import json
import struct
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from ailsrs_jax.runs.plan import Plan
from ailsrs_jax.runs.storage.metrics import read_metrics
from tests.runs import toy_run
from tests.runs.storage.test_tracking import KilledError, kill_at


@pytest.fixture(scope="module")
def plan() -> Plan:
    return toy_run.plan(12, "ars")


def test_trackio_itself(plan: Plan, tmp_path: Path, monkeypatch, caplog) -> None:
    output = tmp_path / "run"
    monkeypatch.setenv("TRACKIO_DIR", str(tmp_path / "trackio"))  # read when it is imported
    pytest.importorskip("trackio")
    with pytest.raises(KilledError):
        toy_run.run(plan, output, track="trackio", watch=kill_at(6))
    toy_run.run(plan, output, track="trackio", resume=True)
    program = """
import trackio, json
from trackio.sqlite_storage import SQLiteStorage
print(json.dumps({
    run.name: SQLiteStorage.get_logs("ailsrs", run.name) for run in trackio.Api().runs("ailsrs")
}))
"""
    printed = subprocess.run(
        [sys.executable, "-c", program], check=True, capture_output=True, text=True
    ).stdout
    logs = json.loads(printed.splitlines()[-1])
    columns = read_metrics(output / "metrics.csv")
    names = sorted(logs)
    assert [name.rpartition(" ")[0] for name in names] == ["run/seed_0", "run/seed_5"]
    for seed, entries in zip(toy_run.SEEDS, map(logs.get, names), strict=True):
        mine = columns["seed"] == seed
        assert [entry["step"] for entry in entries] == list(range(12))
        for name in columns.keys() - {"iteration", "seed"}:
            assert [entry[name] for entry in entries] == columns[name][mine].tolist()
    assert not caplog.records


def test_weights_and_biases_itself(plan: Plan, tmp_path: Path, monkeypatch, caplog) -> None:
    pytest.importorskip("wandb")
    output = tmp_path / "run"
    monkeypatch.setenv("WANDB_MODE", "offline")
    with pytest.raises(KilledError):
        toy_run.run(plan, output, track="wandb", watch=kill_at(6))
    toy_run.run(plan, output, track="wandb", resume=True)
    columns = read_metrics(output / "metrics.csv")
    files = sorted((output / "wandb").glob("offline-run-*/*.wandb"))
    by_name: dict[str, list[Path]] = {}
    for file in files:
        by_name.setdefault(file.name, []).append(file)
    run_id = (output / ".tracker").read_text().strip()
    assert set(by_name) == {f"run-{run_id}-{seed}.wandb" for seed in toy_run.SEEDS}
    for seed in toy_run.SEEDS:
        first, last = (offline_history(file) for file in by_name[f"run-{run_id}-{seed}.wandb"])
        mine = columns["seed"] == seed
        assert [entry["_step"] for entry in last] == list(range(12))
        assert [entry["evaluation_return"] for entry in last] == columns["evaluation_return"][
            mine
        ].tolist()
        assert [entry["env_steps"] for entry in first] == columns["env_steps"][mine][:7].tolist()
    assert not caplog.records


def offline_history(path: Path) -> list[dict[str, Any]]:
    """Read the rows of an offline run, which are records in LevelDB's log format."""
    from wandb.proto.wandb_internal_pb2 import Record

    content, position, parts, rows = path.read_bytes(), 7, b"", []
    while position < len(content):
        left_in_block = 2**15 - position % 2**15
        if left_in_block < 7:
            position += left_in_block
            continue
        size, kind = struct.unpack("<xxxxHB", content[position : position + 7])
        parts += content[position + 7 : position + 7 + size]
        position += 7 + size
        if kind in (1, 4):  # a whole record, or its last part
            record, parts = Record.FromString(parts), b""
            if record.HasField("history"):
                items = record.history.item
                rows.append({i.key or i.nested_key[0]: json.loads(i.value_json) for i in items})
    return rows
