"""Sweeps in separate processes, which are killed at random moments, and sweeps on Ray."""

import contextlib
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from ailsrs_jax.data.demonstrations import save_demonstrations
from tests.point_mass import PointMass, point_mass_demonstrations
from tests.sweeps.toy_sweep import POINT_MASS

SPEC = """
episodes = 2
env = "tests.point_mass:PointMass"
seeds = [0, 1]

[settings]
num_iterations = 100
episode_length = 20

[[grid]]
demonstrations = "point_mass.npz"
num_trajectories = [2, 8]
settings = { num_directions = 4, num_top_directions = 2, num_distance_samples = 50 }

[[grid]]
algorithm = "bc"
demonstrations = "point_mass.npz"

[[grid]]
algorithm = "ars"
"""
NUM_KILLS = 10
ROOT = Path(__file__).parents[2]

pytestmark = [pytest.mark.slow, pytest.mark.timeout(3600)]


@pytest.fixture
def spec(in_tmp_path: Path) -> str:
    recorded = point_mass_demonstrations(PointMass())
    save_demonstrations(recorded.replace(env_id=POINT_MASS), "point_mass.npz")
    Path("spec.toml").write_text(SPEC)
    return "spec.toml"


def start(*arguments: str) -> subprocess.Popen[str]:
    path = f"{ROOT}{os.pathsep}{os.environ.get('PYTHONPATH', '')}"
    return subprocess.Popen(
        [sys.executable, "-m", "ailsrs_jax", "sweep", *arguments, "--own", POINT_MASS],
        env=os.environ | {"PYTHONPATH": path},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def finish(process: subprocess.Popen[str], timeout: float | None = None) -> None:
    printed = process.communicate(timeout=timeout)
    assert process.returncode == 0, printed


def tables(directory: str) -> list[bytes]:
    return [Path(directory, name).read_bytes() for name in ("results.csv", "curves.csv")]


@pytest.mark.parametrize("max_parallel", ["1", "64"])
def test_killed_ten_times_it_ends_with_the_same_tables(spec: str, max_parallel: str) -> None:
    arguments = (spec, "--max-parallel", max_parallel)
    duration = 0.0
    for output in (
        "whole",
        "again",
    ):  # from the second run on, programs are cached
        started = time.monotonic()
        finish(start(*arguments, "--output", output))
        duration = time.monotonic() - started
    assert tables("whole")[0].count(b",done\n") == 8
    assert tables("again") == tables("whole")

    rng = random.Random(0)
    num_kills, num_finished = 0, 0
    while num_kills < NUM_KILLS or num_finished == 0:
        output = f"killed-{num_finished}"
        process = start(*arguments, "--output", output)
        try:
            wait = rng.uniform(0.0, duration) if num_kills < NUM_KILLS else None
            finish(process, wait)
        except subprocess.TimeoutExpired:
            process.send_signal(signal.SIGKILL)
            process.communicate()
            num_kills += 1
        else:
            assert tables(output) == tables("whole")
            num_finished += 1


def test_shards_in_one_directory_at_the_same_time(spec: str) -> None:
    finish(start(spec, "--output", "whole", "--max-parallel", "2"))
    arguments = (spec, "--output", "shared", "--max-parallel", "2", "--shard")
    shards = [start(*arguments, f"{index}/3") for index in range(3)]
    for shard in shards:
        finish(shard)
    assert tables("shared") == tables("whole")


def ray_worker() -> int:
    """Return the process id of the worker that trains in this directory."""
    for process in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            command = (process / "cmdline").read_text()
            if command.startswith("ray::run_unit") and (process / "cwd").readlink() == Path.cwd():
                return int(process.name)
    raise AssertionError("there is no worker")


def test_on_ray(spec: str) -> None:
    pytest.importorskip("ray")
    finish(start(spec, "--output", "whole"))
    on_ray = start(spec, "--output", "ray", "--launcher", "ray")
    # The worker is killed as soon as it trains.
    while not list(Path("ray").glob("cells/*/metrics.csv")):
        assert on_ray.poll() is None, on_ray.communicate()
        time.sleep(0.1)
    os.kill(ray_worker(), signal.SIGKILL)
    finish(on_ray)
    assert tables("ray") == tables("whole")
