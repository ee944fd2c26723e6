"""Random faults for hours: kills, damaged files, odd commands, full disks, diverging physics.

``python -m tests.campaign --hours 9 --directory DIR`` repeats random trials. Each has a number,
which is the seed of its random numbers and is printed first. ``--only`` chooses kinds of trials; a
kind that is named twice is twice as likely. ``--replay NUMBER`` repeats a trial, with the same
``--only``. What a trial that failed has left stays in ``DIR/failed-NUMBER``. ``DIR/summary.json``
holds the counts.

``--long-run`` trains one run instead, and records its resident memory, threads and open files every
minute in ``DIR/resources.csv``. ``DIR/slopes.json`` tells how they change after half an hour.
"""

import argparse
import csv
import json
import random
import shlex
import shutil
import signal
import sys
import time
import traceback
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scipy.stats import linregress, t

from tests.campaign.program import ROOT, start
from tests.campaign.trials import LONG, TRIALS

# Anonymous memory is what the program has allocated. The rest of the resident memory is pages of
# files, which the system takes back and reads again when it likes.
COLUMNS = ("resident_kb", "anonymous_kb", "swapped_kb", "threads", "open_files")
WARM_UP = 30  # minutes of a long run that are not counted
BLOCK = 10  # minutes


def campaign(directory: Path, hours: float, first: int, kinds: Sequence[str]) -> int:
    """Repeat trials until the time is over; return the number of failures."""
    began, number, counts, failures = time.time(), first, Counter[str](), []
    while time.time() < began + 3600 * hours:
        problem = trial(directory, number, counts, kinds)
        if problem is not None:
            # The summary is for others, so it names no directory of this machine.
            for place, name in ((directory, "DIR"), (sys.prefix, "PYTHON"), (ROOT, ".")):
                problem = problem.replace(str(place), name)
            failures.append({"trial": number, "problem": problem[-2000:]})
        number += 1
        summary = {
            "hours": round((time.time() - began) / 3600, 3),
            "trials": number - first,
            "first": first,
            "counts": dict(sorted(counts.items())),
            "failures": failures,
        }
        (directory / "summary.json").write_text(json.dumps(summary, indent=1) + "\n")
    return len(failures)


def trial(directory: Path, number: int, counts: Counter[str], kinds: Sequence[str]) -> str | None:
    """Make one trial, and return the traceback if it failed."""
    rng = random.Random(number)
    name = rng.choice(kinds)
    say(f"{time.strftime('%H:%M:%S')} trial {number}: {name}")
    place = directory / f"failed-{number}"
    shutil.rmtree(place, ignore_errors=True)
    place.mkdir(parents=True)
    try:
        counts.update(TRIALS[name](rng, place))
    except Exception:
        counts["failures"] += 1
        problem = traceback.format_exc()
        say(problem)
        return f"{name}: {problem}"
    counts[f"trials of {name}"] += 1
    shutil.rmtree(place)
    return None


def say(text: str) -> None:
    """Print a line at once, also into a file."""
    sys.stdout.write(f"{text}\n")
    sys.stdout.flush()


def long_run(directory: Path, hours: float) -> None:
    """Train, and write a row of ``resources.csv`` every minute."""
    place = directory / "long"
    place.mkdir(parents=True, exist_ok=True)
    words = [*shlex.split(LONG), "--output", "run", "--quiet"]
    process, began = start(words, place), time.time()
    path = Path(f"/proc/{process.pid}")
    with (directory / "resources.csv").open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(("minute", *COLUMNS))
        for minute in range(int(60 * hours) + 1):
            time.sleep(max(0.0, began + 60 * minute - time.time()))
            if process.poll() is not None:
                raise SystemExit(f"the run has ended: {process.communicate()[1]}")
            fields = dict(line.split(":", 1) for line in (path / "status").read_text().splitlines())
            counts = (int(fields[x].split()[0]) for x in ("VmRSS", "RssAnon", "VmSwap", "Threads"))
            writer.writerow((minute, *counts, len([*(path / "fd").iterdir()])))
            file.flush()
            if minute >= WARM_UP + 3 * BLOCK:
                write_slopes(directory)
    process.send_signal(signal.SIGTERM)
    process.communicate()


def write_slopes(directory: Path) -> None:
    """Write what each column gains in an hour: a least-squares slope with its 95 % interval.

    The line is fitted to means of ten minutes, since neighbouring minutes are alike.
    """
    table = np.genfromtxt(directory / "resources.csv", delimiter=",", names=True)
    table = table[table["minute"] >= WARM_UP]
    num = len(table) // BLOCK
    slopes = {}
    for name in COLUMNS:
        hours, means = (
            table[column][: num * BLOCK].reshape(num, BLOCK).mean(axis=1) / unit
            for column, unit in (("minute", 60), (name, 1))
        )
        fit = linregress(hours, means)
        half = float(np.nan_to_num(t.ppf(0.975, num - 2) * fit.stderr))  # NaN of a constant
        slopes[name] = {"per_hour": round(fit.slope, 2), "plus_or_minus": round(half, 2)}
    (directory / "slopes.json").write_text(json.dumps(slopes, indent=1) + "\n")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--hours", type=float, default=1.0)
    parser.add_argument("--directory", type=Path, default=Path("campaign"))
    parser.add_argument("--first", type=int, default=None, help="number of the first trial")
    parser.add_argument("--replay", type=int, default=None, help="repeat the trial of this number")
    parser.add_argument("--only", choices=TRIALS, nargs="+", default=list(TRIALS))
    parser.add_argument("--long-run", action="store_true")
    arguments = parser.parse_args()
    directory = arguments.directory.absolute()
    directory.mkdir(parents=True, exist_ok=True)
    if arguments.long_run:
        long_run(directory, arguments.hours)
    elif arguments.replay is not None:
        problem = trial(directory, arguments.replay, Counter(), arguments.only)
        raise SystemExit(problem is not None)
    else:
        first = random.randrange(10**9) if arguments.first is None else arguments.first
        raise SystemExit(campaign(directory, arguments.hours, first, arguments.only) > 0)


if __name__ == "__main__":
    main()
