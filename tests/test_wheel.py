"""The wheel: what is in it, and that an empty environment needs nothing else."""

import os
import re
import subprocess
import sys
from pathlib import Path
from zipfile import ZipFile

import pytest

from tests.test_docs import ROOT, blocks

pytestmark = [pytest.mark.slow, pytest.mark.timeout(3600)]


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Built from the source distribution, as an index would get it."""
    output = tmp_path_factory.mktemp("dist")
    subprocess.run([sys.executable, "-m", "build", "--outdir", output, ROOT], check=True)
    assert len(list(output.glob("*.tar.gz"))) == 1
    (built,) = output.glob("*.whl")
    return built


def test_it_holds_the_package_and_nothing_else(wheel: Path) -> None:
    listed = ["git", "ls-files", "ailsrs_jax"]
    tracked = subprocess.run(listed, cwd=ROOT, capture_output=True, text=True, check=True)
    about = ("METADATA", "RECORD", "WHEEL", "entry_points.txt", "licenses/LICENSE")
    info = "-".join(wheel.name.split("-")[:2]) + ".dist-info"
    expected = {*tracked.stdout.split(), *(f"{info}/{name}" for name in about)}
    assert {"ailsrs_jax/py.typed", "ailsrs_jax/data/experts/Hopper-v5.npz"} < expected
    assert set(ZipFile(wheel).namelist()) == expected


def test_quickstart_in_an_empty_environment(wheel: Path, tmp_path: Path) -> None:
    venv, work = tmp_path / "venv", tmp_path / "work"
    work.mkdir()
    # Nothing of this environment, nor of the user's caches.
    clean = {key: value for key, value in os.environ.items() if not key.startswith("PYTHON")}
    clean |= {"HOME": str(tmp_path / "home"), "XDG_CACHE_HOME": str(tmp_path / "cache")}
    subprocess.run([sys.executable, "-m", "venv", venv], check=True)
    subprocess.run([venv / "bin" / "pip", "install", "--quiet", wheel], check=True)
    quickstart = blocks(ROOT / "README.md", "python")[0]
    done = subprocess.run(
        [venv / "bin" / "python", "-c", quickstart],
        cwd=work,
        env=clean,
        capture_output=True,
        text=True,
        check=True,
    )
    assert re.fullmatch(r"\d+ ± \d+\n", done.stdout)
    assert (work / "policy.npz").exists()
    ailsrs = venv / "bin" / "ailsrs"
    evaluate = [ailsrs, "evaluate", "policy.npz", "--episodes", "2"]
    subprocess.run(evaluate, cwd=work, env=clean, check=True)
    train = [ailsrs, "train", "hopper", "--algorithm", "bc", "--num-trajectories", "1"]
    train += ["--iterations", "1", "--output", "run"]
    subprocess.run(train, cwd=work, env=clean, check=True)
    assert (work / "run" / "training_curve.png").exists()
