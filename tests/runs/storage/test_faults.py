"""Runs in processes that are killed, interrupted, started twice and resumed."""

import itertools
import os
import random
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import orbax.checkpoint as ocp
import pytest

from ailsrs_jax.data.policies import load_policy
from ailsrs_jax.errors import UserError
from ailsrs_jax.runs.storage.directory import claimed
from ailsrs_jax.runs.storage.metrics import read_rows
from tests.runs import toy_run

NUM_KILLS = 50
NUM_ITERATIONS = 1500  # more than a fast machine does between the kills
MANY = 100_000  # never reached


@pytest.fixture
def start(
    tmp_path_factory: pytest.TempPathFactory,
) -> Iterator[Callable[..., subprocess.Popen[str]]]:
    """Return a function that starts a toy run; runs that are left at the end are killed."""
    cache = tmp_path_factory.getbasetemp() / "cache"
    processes = []

    def start_one(
        output: Path, iterations: int, every: int, devices: int = 1, algorithm: str = "ailsrs"
    ) -> Any:
        arguments = [str(output), str(iterations), str(every), algorithm]
        environment = dict(os.environ)
        environment.pop("TF_CPP_MIN_LOG_LEVEL", None)  # JAX has set it in this process
        process = subprocess.Popen(
            [sys.executable, "-m", toy_run.__name__, *arguments],
            env=environment
            | {
                "JAX_NUM_CPU_DEVICES": str(devices),
                "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
                "XDG_CACHE_HOME": str(cache),
            },
            stderr=subprocess.PIPE,
            text=True,
        )
        processes.append(process)
        return process

    yield start_one
    for process in processes:
        if process.poll() is None:
            process.kill()
            process.communicate()


def finish(process: subprocess.Popen[str]) -> tuple[int, str]:
    _, errors = process.communicate(timeout=280)
    return process.returncode, errors


def wait_until(process: subprocess.Popen[str], condition: Callable[[], bool]) -> None:
    """Wait until the condition holds or the process has ended."""
    while process.poll() is None and not condition():
        time.sleep(0.0005)


def num_rows(output: Path) -> int:
    """Count the complete lines of ``metrics.csv``, header included."""
    path = output / "metrics.csv"
    return path.read_bytes().count(b"\n") if path.exists() else 0


def newest_state(output: Path) -> tuple[int, list[np.ndarray]]:
    newest = max(int(path.name) for path in (output / "checkpoints").iterdir())
    state = ocp.StandardCheckpointer().restore(output / "checkpoints" / str(newest) / "state")
    import jax

    return newest, [np.asarray(leaf) for leaf in jax.tree.leaves(state)]


def test_signals_save_and_a_second_one_ends_at_once(start, tmp_path: Path) -> None:
    output = tmp_path / "run"
    process = start(output, MANY, MANY, algorithm="ars")
    wait_until(process, lambda: num_rows(output) > 7)

    with pytest.raises(UserError, match="another process is writing to"):
        claimed(output, toy_run.plan(MANY, "ars").config, resume=True).__enter__()
    code, errors = finish(start(output, MANY, MANY, algorithm="ars"))
    assert code == 1
    assert errors == f"refused: another process is writing to {output}\n"

    process.send_signal(signal.SIGTERM)
    code, errors = finish(process)
    assert code == 128 + signal.SIGTERM
    assert errors.startswith("\nSIGTERM: stopping; once more to stop at once")
    assert "Traceback" not in errors
    # There is a checkpoint of the first iteration, and one of where it was stopped.
    done = (num_rows(output) - 1) // 2
    assert newest_state(output)[0] == done > 3
    assert load_policy(output / "seed_5" / "policy.npz").env_id == "PointMass"

    begun = (output / "metrics.csv").stat().st_mtime_ns
    process = start(output, MANY, MANY, algorithm="ars")
    wait_until(process, lambda: (output / "metrics.csv").stat().st_mtime_ns > begun)
    process.send_signal(signal.SIGINT)  # Python handles no signals while XLA compiles
    process.send_signal(signal.SIGTERM)
    code, errors = finish(process)
    assert code in (128 + signal.SIGINT, 128 + signal.SIGTERM)
    assert "stopping" in errors
    # The second signal may arrive before or after the iteration in which the first takes effect.
    newest = newest_state(output)[0]
    assert newest in (done, done + 1)
    assert (num_rows(output) - 1) // 2 in (newest, newest + 1)
    with claimed(output, toy_run.plan(MANY, "ars").config, resume=True):
        pass  # no process holds the lock any more


@pytest.mark.slow
@pytest.mark.timeout(3 * 3600)
def test_killed_fifty_times_is_bitwise_the_same(start, tmp_path: Path) -> None:
    undisturbed, output = tmp_path / "undisturbed", tmp_path / "killed"
    assert finish(start(undisturbed, NUM_ITERATIONS, 3))[0] == 0
    rng = random.Random(0)
    moments = itertools.cycle(["saving", "logging", "anything", "starting"])
    checkpoints = output / "checkpoints"

    def is_saving() -> bool:
        return any("tmp" in path.name for path in checkpoints.glob("*"))

    hits: Counter[str] = Counter()
    for number in range(NUM_KILLS):
        target = num_rows(output) + rng.randrange(1, 6)
        process = start(output, NUM_ITERATIONS, 3)
        moment = next(moments)
        if moment == "starting" and number > 4:
            end = time.monotonic() + rng.uniform(0, 10)
            wait_until(
                process,
                lambda end=end, target=target: time.monotonic() > end or num_rows(output) >= target,
            )
        else:
            # The process first repeats the rows after its checkpoint.
            wait_until(process, lambda target=target: num_rows(output) >= target)
        if moment == "saving":
            wait_until(process, is_saving)
            time.sleep(rng.uniform(0, 0.1))
        elif moment == "anything":
            time.sleep(rng.uniform(0, 0.3))
        assert process.poll() is None, process.communicate()
        process.kill()
        process.communicate()
        left = [path for path in checkpoints.glob("*") if path.is_dir()]
        hits["half a checkpoint"] += is_saving()
        hits["not yet sealed"] += any(
            path.name.isdigit() and not (path / "SHA256SUMS").exists() for path in left
        )
        hits["half a file"] += any(output.rglob(".*.partial"))
        whole = [int(path.parent.name) for path in checkpoints.glob("*/SHA256SUMS")]
        hits["rows beyond the checkpoint"] += num_rows(output) > 1 + 2 * max(whole, default=0)
    sys.stderr.write(f"killed {NUM_KILLS} times, leaving {dict(hits)}\n")

    code, errors = finish(start(output, NUM_ITERATIONS, 3))
    assert (code, errors) == (0, "")
    assert (output / "metrics.csv").read_bytes() == (undisturbed / "metrics.csv").read_bytes()
    assert len(read_rows(output / "metrics.csv")) == 1 + 2 * NUM_ITERATIONS
    (done, state), (expected_done, expected) = map(newest_state, (output, undisturbed))
    assert done == expected_done == NUM_ITERATIONS
    for ours, theirs in zip(state, expected, strict=True):
        np.testing.assert_array_equal(ours, theirs)
    for seed in toy_run.SEEDS:
        path = Path(f"seed_{seed}") / "policy.npz"
        assert (output / path).read_bytes() == (undisturbed / path).read_bytes()
    assert sorted(path.name for path in output.iterdir()) == sorted(
        path.name for path in undisturbed.iterdir()
    )
    assert hits["half a checkpoint"] > 5
    assert hits["rows beyond the checkpoint"] > 5


@pytest.mark.slow
def test_devices_may_come_and_go(start, tmp_path: Path) -> None:
    """Resume on two devices, and on one again: the numbers differ by rounding only."""
    alone, output = tmp_path / "alone", tmp_path / "output"
    assert finish(start(alone, 9, 3))[0] == 0
    for number, devices in enumerate((1, 2, 1)):
        process = start(output, 9, 3, devices)
        wait_until(process, lambda number=number: num_rows(output) > 1 + 2 * 3 * number + 1)
        process.send_signal(signal.SIGINT)
        assert finish(process)[0] in (0, 128 + signal.SIGINT)
    assert finish(start(output, 9, 3))[0] == 0
    rows, expected = (read_rows(path / "metrics.csv")[1:] for path in (output, alone))
    np.testing.assert_allclose(np.array(rows, float), np.array(expected, float), rtol=0.02)
