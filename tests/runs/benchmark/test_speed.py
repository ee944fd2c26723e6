import json
import subprocess
import sys
from pathlib import Path

import pytest

from ailsrs_jax.errors import UserError
from ailsrs_jax.runs.benchmark import peers
from ailsrs_jax.runs.benchmark import speed as benchmark
from ailsrs_jax.runs.benchmark.speed import Measurement, measure


@pytest.mark.slow
@pytest.mark.parametrize("engine", ["mujoco", "mjx"])
def test_stages_of_one_engine(engine: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    done: Measurement = measure("HalfCheetah-v5", engine, 4, 20, 3)
    stages = ["bare", "simulate", "train"]
    whole = ["limit"] if engine == "mujoco" else []
    assert [row.stage for row in done.rows] == whole + stages
    for row in done.rows:
        assert (row.env, row.physics) == ("HalfCheetah-v5", engine)
        assert row.env_steps_per_s > 0
        assert row.peak_memory_mb > 100
        assert row.compile_s is not None
    assert done.rows[-2].utilization == (1.0 if engine == "mjx" else None)  # nobody falls
    assert set(done.ratios) == {
        f"HalfCheetah-v5 {engine} {stage} / {base}"
        for stage in stages[1:]
        for base in (*whole, "bare")
    }
    assert all(ratio > 0 for ratio in done.ratios.values())


def test_peers_that_are_not_installed_are_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    absent = peers.Peer("no_such_package", "mujoco", lambda *_: 1.0)
    monkeypatch.setattr(peers, "PEERS", {"absent": absent})
    assert list(benchmark.benchmark(["Hopper-v5"], [], 1, 1, 1)) == []


def test_a_measurement_that_fails_is_one_line() -> None:
    with pytest.raises(UserError, match=r"int\('x',\) failed: ValueError"):
        benchmark._in_a_process(int, "x")


def test_gymnasium_is_stepped(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(peers, "SECONDS", 0.05)
    assert peers.gymnasium_vector("Swimmer-v5") > 0
    assert peers.gymnasium_workers("Swimmer-v5", 2, 20) > 0


@pytest.mark.slow
def test_the_whole_command() -> None:
    command = "-m ailsrs_jax benchmark hopper --physics mujoco --json --repeats 1"
    sizes = "--num-directions 2 --episode-length 10"
    arguments = [sys.executable, *command.split(), *sizes.split()]
    result = subprocess.run(arguments, check=True, capture_output=True, text=True)
    report = json.loads(result.stdout)
    assert {"bare", "train", "peer:gymnasium", "peer:brax_ars"} <= {
        row["stage"] for row in report["rows"]
    }
    assert "Hopper-v5 mujoco train / peer:brax_ars" in report["ratios"]
