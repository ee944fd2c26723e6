"""The program ``ailsrs`` as a process that a trial starts, kills and compares."""

import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

ROOT = Path(__file__).parents[2]
LONGEST = 600.0  # seconds of a process before it counts as hanging


def start(words: list[str], directory: Path) -> subprocess.Popen[str]:
    """Start ``ailsrs`` in ``directory``; programs that it compiles are kept for the next trials."""
    cache = directory.parent / "cache"
    environment = os.environ | {
        "PYTHONPATH": str(ROOT),
        "JAX_COMPILATION_CACHE_DIR": str(cache / "xla"),
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
        "XDG_CACHE_HOME": str(cache),
    }
    return subprocess.Popen(
        [sys.executable, "-m", "ailsrs_jax", *words],
        cwd=directory,
        env=environment,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )


def finish(process: subprocess.Popen[str], codes: tuple[int, ...] = (0,)) -> str:
    """Wait for the end, and return standard error; a traceback or another code is a failure."""
    try:
        _, errors = process.communicate(timeout=LONGEST)
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)
        raise AssertionError(f"it hangs: {process.args}") from None
    assert "Traceback" not in errors, (process.args, errors)
    assert process.returncode in codes, (process.args, process.returncode, errors)
    return errors


def kill_until_finished(
    words: Callable[[], list[str]], directory: Path, rng: random.Random, seconds: float, kills: int
) -> int:
    """Kill the program up to ``kills`` times within ``seconds``; return how often it was killed.

    Args:
        words: of the command, which is asked again for each start, because a run resumes.
        directory: where it runs.
        rng: of the moments.
        seconds: about what it takes undisturbed.
        kills: the most kills; after them it may finish.
    """
    for number in range(kills):
        process = start(words(), directory)
        end = time.monotonic() + rng.uniform(0, seconds)
        while process.poll() is None and time.monotonic() < end:
            time.sleep(0.01)
        if process.poll() is not None:
            finish(process)
            return number
        os.killpg(process.pid, signal.SIGKILL)
        process.communicate()
    finish(start(words(), directory))
    return kills


def contents(*paths: Path) -> list[bytes]:
    """The bytes of files that must not depend on what happened meanwhile."""
    return [path.read_bytes() for path in paths]
