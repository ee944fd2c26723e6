"""The process that tells a tracker of runs: it reads ``metrics.csv`` while they write it.

A tracker may print, prompt, hang or crash here: none of it reaches the runs. Whatever the tracker
lacks of earlier processes is sent first, so that nothing is lost or doubled when a run is resumed.

It is told on standard input what to do, as JSON in a line; the end of its input is the end of the
runs, in whatever way they ended. What it says on standard output is why it failed.
"""

import contextlib
import csv
import fcntl
import json
import os
import re
import secrets
import signal
import sys
import threading
from pathlib import Path
from typing import Any

from ailsrs_jax.errors import one_line
from ailsrs_jax.runs.storage.trackers import TRACKERS, About, Opened

POLL_SECONDS = 1.0
ID_FILE = ".tracker"  # in a run directory: what trackers know it by


class Follower:
    """Sends what is new in the directory of a run to a tracker, each seed as a run of its own."""

    def __init__(self, tracker_name: str, directory: Path) -> None:
        """Wait until an earlier process has finished with the same directory."""
        self._lock = (directory / ID_FILE).open("a+")  # held as long as this process lives
        with contextlib.suppress(OSError):  # not every file system can
            fcntl.flock(self._lock, fcntl.LOCK_EX)
        self._lock.seek(0)
        run_id = self._lock.read().strip()
        if not re.fullmatch("[0-9a-f]{12}", run_id):
            run_id = secrets.token_hex(6)
            self._lock.truncate(0)
            self._lock.write(f"{run_id}\n")
            self._lock.flush()
        config: dict[str, Any] = json.loads((directory / "config.json").read_text())
        seeds = config.pop("seeds")
        group = re.sub(r"-seed\d+$", "", directory.name)  # as the cells of a sweep are called
        self._opened: dict[str, Opened] = {
            str(seed): TRACKERS[tracker_name](
                About(
                    id=f"{run_id}-{seed}",
                    name=directory.name if len(seeds) == 1 else f"{directory.name}/seed_{seed}",
                    group=group,
                    config=config | {"seed": seed},
                    directory=directory,
                )
            )
            for seed in seeds
        }
        self._rows = (directory / "metrics.csv").open()
        self._header: list[str] = []

    def send(self) -> None:
        """Whatever is new."""
        while True:
            position = self._rows.tell()
            line = self._rows.readline()
            if not line.endswith("\n"):  # nothing, or not all of it
                self._rows.seek(position)
                return
            (values,) = csv.reader([line])
            if not self._header:
                self._header = values
                continue
            row = dict(zip(self._header, values, strict=True))
            iteration, opened = int(row.pop("iteration")), self._opened[row.pop("seed")]
            if iteration >= opened.next_step:
                metrics = {name: float(value) for name, value in row.items()}
                opened.run.log(metrics, step=iteration)

    def finish(self) -> None:
        """Return when all has arrived."""
        for opened in self._opened.values():
            opened.run.finish()


def main() -> None:
    """Follow the runs in the directories that standard input names, until it ends."""
    for number in (signal.SIGINT, signal.SIGTERM):  # the run's affair, which ends this
        signal.signal(number, signal.SIG_IGN)
    answer = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    name, directories, finish_seconds = json.loads(sys.stdin.readline())
    ended = threading.Event()

    def wait_for_end() -> None:
        sys.stdin.read()
        ended.set()
        signal.alarm(finish_seconds)

    threading.Thread(target=wait_for_end, daemon=True).start()
    try:
        followers = [Follower(name, Path(directory)) for directory in directories]
        over = False
        while not over:
            over = ended.wait(POLL_SECONDS)
            for follower in followers:
                follower.send()
        for follower in followers:
            follower.finish()
    except Exception as error:  # somebody else's code may raise anything
        answer.write(one_line(error))
        answer.close()
        sys.exit(1)


if __name__ == "__main__":
    main()
