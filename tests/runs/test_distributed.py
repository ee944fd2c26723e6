"""One run in two processes, which connect to each other as the tasks of a SLURM job do."""

import os
import random
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from ailsrs_jax.data.demonstrations import save_demonstrations
from ailsrs_jax.runs.storage.metrics import read_rows
from tests.point_mass import PointMass, point_mass_demonstrations

ENV_ID = "tests.point_mass:PointMass"
COMMAND = f"train {ENV_ID} --iterations 2 --seeds 0 5"
SETTINGS = "--set num_directions=4 num_top_directions=2 episode_length=20"
ALGORITHMS = {
    "ars": "--algorithm ars",
    "ailsrs": "memory_samples=80 --demonstrations point_mass.npz",  # takes long to compile
}


def start(output: Path, algorithm: str, *flags: str, **environment: str) -> subprocess.Popen[str]:
    command = f"{COMMAND} {SETTINGS} {ALGORITHMS[algorithm]} --output {output.name}"
    arguments = [*command.split(), *flags]
    environment["JAX_NUM_CPU_DEVICES"] = "1"
    environment["PYTHONPATH"] = str(Path(__file__).parents[2])
    return subprocess.Popen(
        [sys.executable, "-m", "ailsrs_jax", *arguments],
        cwd=output.parent,
        env=os.environ | environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )


def start_two(
    output: Path, algorithm: str, job: dict[str, str], *flags: str
) -> list[subprocess.Popen[str]]:
    flags = ("--distributed", *flags)
    return [
        start(output, algorithm, *flags, **job, SLURM_PROCID=rank, SLURM_LOCALID=rank)
        for rank in ("0", "1")
    ]


def check_resuming(output: Path, job: dict[str, str]) -> None:
    """Both processes resume from the same checkpoint, and an error in one ends both."""
    whole = (output / "metrics.csv").read_bytes()
    damaged = output / "checkpoints" / "2" / "about" / "metadata"
    damaged.write_bytes(b"x" + damaged.read_bytes()[1:])
    first, second = map(finish, start_two(output, "ars", job, "--resume"))
    assert first.count("checkpoint 2 in") == 1
    assert "is damaged: resuming from 1" in first
    assert "damaged" not in second
    assert (output / "metrics.csv").read_bytes() == whole

    (output / "metrics.csv").write_bytes(whole[: whole.index(b"\n") + 1])
    processes = start_two(output, "ars", job, "--resume")
    first, second = (process.communicate(timeout=240)[0] for process in processes)
    assert [process.returncode for process in processes] == [2, 2]
    assert "metrics.csv lacks" in first.splitlines()[-1]
    assert second.splitlines()[-1] == "ailsrs: another process of this run has failed"


def finish(process: subprocess.Popen[str]) -> str:
    output, _ = process.communicate(timeout=240)
    assert process.returncode == 0, output
    return output


@pytest.mark.slow
@pytest.mark.parametrize("algorithm", ["ars", "ailsrs"])
def test_two_processes_are_one_run(algorithm: str, tmp_path: Path) -> None:
    recorded = point_mass_demonstrations(PointMass()).replace(env_id=ENV_ID)
    save_demonstrations(recorded, tmp_path / "point_mass.npz")
    job = {
        "SLURM_JOB_ID": str(random.randrange(10**6)),  # JAX takes its port from this
        "SLURM_STEP_NODELIST": "localhost",
        "SLURM_NTASKS": "2",
    }
    together, alone = tmp_path / "together", tmp_path / "alone"
    processes = start_two(together, algorithm, job)
    first, second = map(finish, processes)
    assert "devices: 2" in first
    assert "policies, metrics" in first
    assert "PointMass" not in second  # only the first prints and writes
    finish(start(alone, algorithm))

    header, *rows = read_rows(together / "metrics.csv")
    _, *expected = read_rows(alone / "metrics.csv")
    assert len(rows) == 4
    np.testing.assert_allclose(
        np.array(rows, float), np.array(expected, float), rtol=0.01, atol=1e-3, err_msg=str(header)
    )
    for seed in (0, 5):
        ours, theirs = (np.load(run / f"seed_{seed}" / "policy.npz") for run in (together, alone))
        np.testing.assert_allclose(ours["weights"], theirs["weights"], atol=1e-3)
    if algorithm == "ars":
        check_resuming(together, job)
