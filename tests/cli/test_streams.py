"""Output that cannot be printed: the command goes on, or saves what it has."""

import json
import os
import shlex
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from ailsrs_jax.cli import main as cli
from ailsrs_jax.data.policies import expert_path
from tests.cli.test_terminal import TRAIN

pytestmark = pytest.mark.usefixtures("in_tmp_path")
FULL = "ailsrs: cannot print: No space left on device\n"


def start(command: str, stdout: Any = subprocess.PIPE, **variables: str) -> subprocess.Popen[str]:
    # XLA's warnings are off as ever, although JAX has set this variable in the test's process.
    variables |= {"TF_CPP_MIN_LOG_LEVEL": "3", "PYTHONPATH": str(Path(cli.__file__).parents[2])}
    return subprocess.Popen(
        [sys.executable, "-m", "ailsrs_jax", *shlex.split(command)],
        stdout=stdout,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | variables,
    )


@pytest.mark.parametrize("command", ["--version", "--help", "train --help"])
def test_output_that_is_full_is_one_line(command: str) -> None:
    with Path("/dev/full").open("w") as full:
        process = start(command, full)
        assert process.communicate()[1] == FULL
    assert process.returncode == 2


def test_a_run_goes_on_when_output_is_full() -> None:
    with Path("/dev/full").open("w") as full:
        process = start(f"{TRAIN} --iterations 3 --output run", full)
        assert process.communicate()[1] == FULL
    assert process.returncode == 2
    assert json.loads(Path("run/result.json").read_text())["finished"]
    assert Path("run/training_curve.png").exists()


def test_a_run_is_saved_when_its_reader_goes() -> None:
    with start(f"{TRAIN} --iterations 100000 --output run") as process:
        assert process.stdout is not None
        assert process.stderr is not None
        assert process.stdout.readline()
        process.stdout.close()
        saved, command = process.stderr.read().splitlines()
    assert (process.returncode, saved) == (141, "saved; continue with:")
    assert command.endswith("--resume")
    assert not json.loads(Path("run/result.json").read_text())["finished"]


def test_characters_that_cannot_be_printed_are_escapes() -> None:
    command = f"evaluate {expert_path('Swimmer-v5')} --episodes 1"
    printed, errors = start(command, PYTHONIOENCODING="ascii", COLUMNS="200").communicate()
    assert not errors
    assert r"\xb1 0" in printed
