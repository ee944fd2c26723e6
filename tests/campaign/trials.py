"""The trials: each takes random numbers and an empty directory, and counts what it has tried.

A failure is an AssertionError. Whatever is compared was made in ``baseline`` by the same command,
undisturbed.
"""

import contextlib
import os
import random
import resource
import shlex
import signal
import subprocess
import sys
import threading
import zlib
from collections import Counter
from collections.abc import Callable
from pathlib import Path

from tests.campaign.program import ROOT, contents, finish, kill_until_finished, start
from tests.fuzz.readers import READERS

Counts = Counter[str]
SEARCH = "num_directions=4 num_top_directions=2 num_evaluation_episodes=2"
POINT_MASS = "tests.point_mass:PointMass"
TRAIN = f"train {POINT_MASS} --algorithm ars --set {SEARCH} episode_length=20 num_iterations=10000"
LONG = (
    "train hopper --demonstrations expert:linear --num-trajectories 1 --iterations 100000000 "
    "--set finish_distance=1e-9"
)
WORKERS = (
    "train gymnasium:Pendulum-v1 --algorithm ars "
    f"--set {SEARCH} episode_length=50 num_iterations=1000"
)
EXPLODING = "tests.exploding:ExplodingPointMass"
SPEC = f"""
episodes = 2
env = "{POINT_MASS}"
algorithm = "ars"
seeds = [0, 1]
[settings]
num_iterations = 6000
episode_length = 20
num_directions = [4, 6]
num_top_directions = 2
[[grid]]
"""
KILLS = 25  # of one run, at most
VOCABULARY = shlex.split(
    "train evaluate demonstrate expert sweep merge benchmark render report export inspect --help "
    "hopper hoper swimmer gymnasium:Nothing-v0 nowhere:Task : --set a=1 num_iterations=1 "
    "step_size=nan step_size=-1 --seeds 0 -1 99999999999999999999 --output /dev/full out out.npz "
    "out.mp4 '' . .. --episodes 0 --episode-length --physics mjx bullet --quiet --json --env "
    "--own x:y --resume --preset paper --algorithm bc x:y --num-trajectories --demonstrations "
    "missing.npz minari:no/such-v0 --shard 1/0 --dry-run --track nobody \u00e9\u2028"
)


def kill_train(rng: random.Random, directory: Path) -> Counts:
    """Kill a run at random moments and resume it."""

    def files(output: Path) -> list[bytes]:
        return contents(output / "metrics.csv", output / "seed_0" / "policy.npz")

    baseline = _baseline(directory, TRAIN)
    output = directory / "run"

    def words() -> list[str]:
        resume = ["--resume"] if (output / "config.json").exists() else []
        return [*shlex.split(TRAIN), "--output", "run", *resume]

    killed = kill_until_finished(words, directory, rng, 6, KILLS)
    assert files(output) == files(baseline)
    return Counter(kills_of_train=killed)


def kill_sweep(rng: random.Random, directory: Path) -> Counts:
    """Kill a sweep at random moments and go on with it."""
    words = ["sweep", "spec.toml", "--own", POINT_MASS, "--output", "sweep"]
    baseline = directory.parent / f"baseline-{zlib.crc32(SPEC.encode())}"
    for each in (directory, baseline):
        each.mkdir(exist_ok=True)
        (each / "spec.toml").write_text(SPEC)
    if not (baseline / "sweep" / "results.csv").exists():
        finish(start(words, baseline))

    def tables(place: Path) -> list[bytes]:
        return contents(*(place / "sweep" / name for name in ("results.csv", "curves.csv")))

    killed = kill_until_finished(lambda: words, directory, rng, 8, KILLS)
    assert tables(directory) == tables(baseline)
    return Counter(kills_of_sweep=killed)


def kill_workers(rng: random.Random, directory: Path) -> Counts:
    """Kill worker processes of a run, which goes on."""
    return Counter(kills_of_workers=_kill_helpers(rng, directory, "2", "", 1.0))


def kill_actors(rng: random.Random, directory: Path) -> Counts:
    """Kill actors on Ray; the run goes on, and its numbers are those of local workers."""
    return Counter(kills_of_actors=_kill_helpers(rng, directory, "ray:2", "ray::_Actor", 3.0))


def _kill_helpers(
    rng: random.Random, directory: Path, workers: str, name: str, pause: float
) -> int:
    """Kill processes of a run whose command begins with ``name``; return how many.

    They are ``pause`` to three times ``pause`` seconds apart, because a worker that dies three
    times while it starts ends the run.
    """
    baseline = _baseline(directory, WORKERS)
    words = [*shlex.split(WORKERS), "--workers", workers, "--output", "run"]
    process = start(words, directory)
    number, over = 0, threading.Event()

    def kill() -> None:
        nonlocal number
        while not over.wait(rng.uniform(pause, 3 * pause)):
            if (directory / "run" / "metrics.csv").exists():
                found = [each for each in _descendants(process.pid) if _command(each, name)]
                with contextlib.suppress(ProcessLookupError):
                    if found:
                        os.kill(rng.choice(found), signal.SIGKILL)
                        number += 1

    killer = threading.Thread(target=kill)
    killer.start()
    try:
        finish(process)
    finally:
        over.set()
        killer.join()
    assert number > 0, "nothing was killed"
    names = ("metrics.csv", "seed_0/policy.npz")
    assert contents(*(directory / "run" / x for x in names)) == contents(
        *(baseline / x for x in names)
    )
    return number


def fuzz(rng: random.Random, directory: Path) -> Counts:
    """Damaged files of one reader: also hostile configurations and sweep specs."""
    # Hypothesis remembers what it has tried, so a process with ten times as many files is slower.
    name, scale = rng.choice(list(READERS)), 50
    test = f"tests/test_fuzz.py::test_damaged_files_give_a_value_or_one_line[{name}]"
    options = [f"--hypothesis-seed={rng.randrange(2**31)}", f"--basetemp={directory / 'fuzz'}"]
    command = [sys.executable, "-m", "pytest", "-q", "-n", "0", "--timeout=3600", *options, test]
    environment = os.environ | {"FUZZ_SCALE": str(scale), "PYTHONPATH": str(ROOT)}
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout[-20_000:]
    return Counter(fuzzed_files=scale * READERS[name].inputs)


def command_line(rng: random.Random, directory: Path) -> Counts:
    """A random command line ends with a value or one line."""
    words = rng.choices(VOCABULARY[:11], k=1) + rng.choices(VOCABULARY, k=rng.randrange(6))
    process = start(words, directory)
    errors = finish(process, codes=(0, 2))
    if process.returncode == 2:
        assert errors.strip(), words
    return Counter(command_lines=1)


def full_disk(rng: random.Random, directory: Path) -> Counts:
    """Files cannot grow beyond a random size; without the limit the run resumes."""
    baseline = _baseline(directory, TRAIN)
    words = [*shlex.split(TRAIN), "--output", "run"]
    limit = int(10 ** rng.uniform(2, 6.5))
    process = start(words, directory)
    resource.prlimit(process.pid, resource.RLIMIT_FSIZE, (limit, limit))
    errors = finish(process, codes=(0, 2))
    if process.returncode == 2:
        assert len(errors.strip().splitlines()) <= 2, errors
    if (directory / "run" / "config.json").exists():
        words.append("--resume")
    finish(start(words, directory))
    names = ("metrics.csv", "seed_0/policy.npz")
    assert contents(*(directory / "run" / x for x in names)) == contents(
        *(baseline / x for x in names)
    )
    return Counter(full_disks=1)


def divergence(rng: random.Random, directory: Path) -> Counts:
    """Physics of which a share diverges trains, or is refused in one line."""
    steps = rng.choice(["step_size=1e30", "noise_std=1e30", "step_size=0.02", "noise_std=1e-30"])
    words = f"train {EXPLODING} --algorithm ars --seeds {rng.randrange(1000)} --output run "
    words += f"--set {SEARCH} episode_length=20 num_iterations=5 {steps}"
    finish(start(shlex.split(words), directory), codes=(0, 2))
    return Counter(diverging_runs=1)


TRIALS: dict[str, Callable[[random.Random, Path], Counts]] = {
    each.__name__: each
    for each in (
        *(kill_train, kill_sweep, kill_workers, kill_actors),
        *(fuzz, command_line, full_disk, divergence),
    )
}


def _baseline(directory: Path, command: str) -> Path:
    """Return the run that the command makes undisturbed; trials share it."""
    place = directory.parent / f"baseline-{zlib.crc32(command.encode())}"
    place.mkdir(exist_ok=True)
    if not (place / "finished").exists():
        finish(start([*shlex.split(command), "--output", "run"], place))
        (place / "finished").touch()
    return place / "run"


def _descendants(parent: int) -> list[int]:
    """Processes that ``parent`` and its descendants have started."""
    found = []
    for thread in Path(f"/proc/{parent}/task").glob("*/children"):
        with contextlib.suppress(OSError):
            for child in map(int, thread.read_text().split()):
                found += [child, *_descendants(child)]
    return found


def _command(process: int, name: str) -> bool:
    """Whether the command of the process begins with ``name``."""
    with contextlib.suppress(OSError):
        return Path(f"/proc/{process}/cmdline").read_bytes().startswith(name.encode())
    return False
