"""Compare the time to 0.9 of the expert: our `ailsrs` and `gail`, and GAIL of `imitation`.

usage: python experiments/peer/compare.py [ENV] [--seeds 0 1 2] [--systems NAME ...]
           [--demonstrations FILE] [--max-steps 2000000] [--output FILE.json]
       make peer                                       (installs .venv-peer first; ENV is hopper)

All systems learn from one file; by default it has ten trajectories of the expert in the package. A
run ends when an evaluation of the unperturbed or deterministic policy returns 0.9 of the mean
return in the file. An evaluation has four episodes, sixteen for `ailsrs`. A run also ends after
--max-steps environment steps, and one of ours after the iterations of the task's preset.

Systems: `ailsrs` and `gail` are `ailsrs train` with the default preset, which starts from behaviour
cloning. `gail-from-nothing` starts without it, and so do `imitation-benchmark` and
`imitation-tutorial`; `imitation_gail.py` describes the settings of these two.

How time is measured: each run is its own process, alone on the machine, one seed after the other.
Every system appends its evaluations to a file, which this process reads twenty times a second. The
time ends at the line that reaches the target. It starts with the process, so it includes everything
that a user waits for: Python's imports, loading the demonstrations, compilation (with an empty
compilation cache) and, for our systems, behaviour cloning and evaluations. The time of the peer's
evaluations is subtracted, because the peer evaluates only for this measurement: at the end of the
round in which it completes 10,000 steps. Environment steps are those of training and, for our
systems, of evaluations. A run that reaches the target is killed, so the results do not show what it
would do later. With demonstrations of a linear expert, our cloned start may reach the target at
once.

It prints a table and writes the runs with their curves to experiments/peer/ENV.json.
"""

import argparse
import csv
import dataclasses
import json
import math
import os
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from ailsrs_jax.data.demonstrations import load_demonstrations
from ailsrs_jax.envs.registry import resolve_env_id, short_name
from ailsrs_jax.sweeps.tables import hardware

HERE = Path(__file__).resolve().parent
PEER_PYTHON = HERE.parents[1] / ".venv-peer/bin/python"
SYSTEMS = ("ailsrs", "gail", "gail-from-nothing", "imitation-benchmark", "imitation-tutorial")
FROM_NOTHING = ("--set", "behavior_cloning_start=false", "--iterations", "1000")
NUM_TRAJECTORIES = 10
SHARE = 0.9  # of the expert's mean return
LOOK_EVERY = 0.05  # seconds


@dataclasses.dataclass(frozen=True)
class Evaluation:
    """One evaluation that a system reports."""

    env_steps: int
    return_mean: float
    uncounted_seconds: float  # spent on all evaluations so far, if they are not counted


@dataclasses.dataclass(frozen=True)
class Run:
    """The result of one run; its steps and seconds are those of the last evaluation."""

    system: str
    seed: int
    reached: bool
    env_steps: int
    seconds: float
    curve: list[tuple[int, float, float]]  # environment steps, seconds, return


def train(
    system: str, env_id: str, demonstrations: Path, seed: int, target: float, max_steps: int
) -> Run:
    """Start the run, watch it until it reaches the target, and end it."""
    with tempfile.TemporaryDirectory() as name:
        directory = Path(name)
        environment = os.environ | {"JAX_COMPILATION_CACHE_DIR": str(directory / "compiled")}
        arguments = ["--seed", str(seed), "--target", str(target), "--max-steps", str(max_steps)]
        if system.startswith("imitation-"):
            command = [PEER_PYTHON, HERE / "imitation_gail.py", demonstrations, *arguments]
            command += ["--settings", system.removeprefix("imitation-")]
            read, file = read_lines, directory / "output"
        else:
            algorithm, _, start = system.partition("-")
            command = [sys.executable, "-m", "ailsrs_jax", "train", env_id]
            command += ["--algorithm", algorithm, *(FROM_NOTHING if start else ())]
            command += ["--demonstrations", demonstrations, "--seeds", str(seed)]
            command += ["--output", directory / "run"]
            read, file = read_metrics, directory / "run" / "metrics.csv"
        with (directory / "output").open("w") as output, (directory / "errors").open("w") as errors:
            started = time.perf_counter()
            process = subprocess.Popen(
                [str(part) for part in command],
                stdout=output,
                stderr=errors,
                cwd=directory,
                env=environment,
                start_new_session=True,
            )
            try:
                curve = watch(process, started, file, read, target, max_steps)
            finally:
                failed = bool(process.poll())
                if process.poll() is None:
                    os.killpg(process.pid, signal.SIGKILL)
                process.wait()
        if failed or not curve:
            said = "".join((directory / name).read_text() for name in ("output", "errors"))
            sys.exit(f"{system}, seed {seed} failed:\n{said[-2000:]}")
    env_steps, seconds, return_mean = curve[-1]
    return Run(system, seed, return_mean >= target, env_steps, seconds, curve)


def watch(
    process: subprocess.Popen[bytes],
    started: float,
    file: Path,
    read: Callable[[str], list[Evaluation]],
    target: float,
    max_steps: int,
) -> list[tuple[int, float, float]]:
    """Return steps, seconds and return of each evaluation, up to the one that ends the run."""
    curve: list[tuple[int, float, float]] = []
    while True:
        running = process.poll() is None  # checked before reading, so that no last lines are missed
        seconds = time.perf_counter() - started
        text = file.read_text() if file.exists() else ""
        whole_lines = text[: text.rfind("\n") + 1]
        for evaluation in read(whole_lines)[len(curve) :]:
            counted = round(seconds - evaluation.uncounted_seconds, 2)
            curve.append((evaluation.env_steps, counted, evaluation.return_mean))
            if evaluation.return_mean >= target or evaluation.env_steps >= max_steps:
                return curve
        if not running:
            return curve
        time.sleep(LOOK_EVERY)


def read_metrics(text: str) -> list[Evaluation]:
    """Read the evaluations in our ``metrics.csv``."""
    return [
        Evaluation(int(row["env_steps"]), float(row["evaluation_return"]), 0.0)
        for row in csv.DictReader(text.splitlines())
    ]


def read_lines(text: str) -> list[Evaluation]:
    """Read the evaluations that ``imitation_gail.py`` prints."""
    rows = [json.loads(line) for line in text.splitlines()]
    return [
        Evaluation(row["env_steps"], row["return_mean"], row["evaluation_seconds"]) for row in rows
    ]


def median(runs: Sequence[Run], quantity: str) -> tuple[float, bool]:
    """Return the median, and whether it is known; if not, it is a lower bound."""
    to_target = statistics.median(getattr(r, quantity) if r.reached else math.inf for r in runs)
    spent = statistics.median(getattr(run, quantity) for run in runs)
    return (spent, False) if math.isinf(to_target) else (to_target, True)


def print_table(runs: Sequence[Run]) -> None:
    """Print one row for each system, and the ratios of the peer's medians to ours."""
    by_system = {run.system: [r for r in runs if r.system == run.system] for run in runs}
    medians = {
        system: {name: median(mine, name) for name in ("env_steps", "seconds")}
        for system, mine in by_system.items()
    }
    seeds = sorted({run.seed for run in runs})
    print(f"| system | {' | '.join(f'seed {seed}' for seed in seeds)} | median |")
    print(f"|---|{'---|' * len(seeds)}---|")
    for system, mine in by_system.items():
        cells = []
        for run in sorted(mine, key=lambda run: run.seed):
            within = "" if run.reached else "not within "
            cells.append(f"{within}{run.env_steps / 1e6:.2f} M, {run.seconds:.0f} s")
        (steps, known), (seconds, _) = medians[system].values()
        cells.append(f"{'' if known else '> '}{steps / 1e6:.2f} M, {seconds:.0f} s")
        print(f"| {system} | {' | '.join(cells)} |")
    for ours in by_system:
        for peer in by_system:
            known = medians[ours]["seconds"][1]
            if ours.startswith("imitation-") or not peer.startswith("imitation-") or not known:
                continue
            steps, seconds = (
                medians[peer][name][0] / medians[ours][name][0] for name in ("env_steps", "seconds")
            )
            sign = "" if medians[peer]["seconds"][1] else "> "
            print(f"{peer} / {ours}: {sign}{seconds:.1f} x the time, {sign}{steps:.2f} x the steps")


def main() -> None:
    """Run all systems, print the table, and write the file."""
    parser = argparse.ArgumentParser()
    parser.add_argument("env", nargs="?", default="hopper")
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2])
    parser.add_argument("--systems", nargs="+", choices=SYSTEMS, default=SYSTEMS)
    parser.add_argument("--demonstrations", type=Path)
    parser.add_argument("--max-steps", type=int, default=2_000_000)
    parser.add_argument("--output", type=Path)
    arguments = parser.parse_args()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))  # also ends the current run
    env_id = resolve_env_id(arguments.env)
    output = arguments.output or HERE / f"{short_name(env_id)}.json"
    if not PEER_PYTHON.exists() and any(name.startswith("imit") for name in arguments.systems):
        sys.exit("no .venv-peer: run make peer to install it")

    with tempfile.TemporaryDirectory() as directory:
        path = arguments.demonstrations and arguments.demonstrations.resolve()
        if path is None:
            path = Path(directory) / "demonstrations.npz"
            command = [sys.executable, "-m", "ailsrs_jax", "demonstrate", env_id]
            command += ["--num-trajectories", str(NUM_TRAJECTORIES), "--output", str(path)]
            subprocess.run(command, check=True)
        expert_returns = np.asarray(load_demonstrations(path).returns)
        target = SHARE * float(expert_returns.mean())
        print(
            f"{env_id}, {len(expert_returns)} demonstrations of return "
            f"{expert_returns.mean():.0f} ± {expert_returns.std():.0f}; target {target:.0f}",
            flush=True,
        )
        runs: list[Run] = []
        for seed in arguments.seeds:
            for system in arguments.systems:
                run = train(system, env_id, path, seed, target, arguments.max_steps)
                runs.append(run)
                print(
                    f"{system}, seed {seed}: {'' if run.reached else 'not '}reached, "
                    f"{run.env_steps:,} steps, {run.seconds:.1f} s",
                    flush=True,
                )
    content = {
        "env_id": env_id,
        "expert_returns": expert_returns.tolist(),
        "target": target,
        "max_steps": arguments.max_steps,
        "hardware": hardware(),
        "runs": [dataclasses.asdict(run) for run in runs],
    }
    output.write_text(json.dumps(content) + "\n")
    print()
    print_table(runs)


if __name__ == "__main__":
    main()
