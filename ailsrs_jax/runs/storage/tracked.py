"""Telling a tracker of runs, without depending on it."""

import contextlib
import json
import logging
import os
import signal
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import ailsrs_jax
from ailsrs_jax.errors import one_line
from ailsrs_jax.runs.storage import tracker_process
from ailsrs_jax.runs.storage.metrics import IterationReport

FINISH_SECONDS = 60  # that the last metrics may take to arrive

logger = logging.getLogger(__name__)


class TrackerProcess:
    """Runs :mod:`tracker_process`; warns once if it is lost, and raises nothing."""

    def __init__(self, tracker: str, directories: Sequence[Path]) -> None:
        """Tell ``tracker`` of the runs in ``directories``, which have ``metrics.csv`` already."""
        self._tracker = tracker
        package_parent = str(Path(ailsrs_jax.__file__).parents[1])
        search = [package_parent, *filter(None, [os.environ.get("PYTHONPATH")])]
        self._process: subprocess.Popen[str] | None = None  # while it is of use
        try:
            self._process = subprocess.Popen(
                [sys.executable, "-m", tracker_process.__name__],
                env=os.environ | {"PYTHONPATH": os.pathsep.join(search)},
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                text=True,
                start_new_session=True,  # a terminal's Ctrl-C is not for it
            )
        except OSError as error:
            self._give_up(one_line(error))
            return
        paths = [str(directory.absolute()) for directory in directories]
        job = json.dumps([tracker, paths, FINISH_SECONDS])
        assert self._process.stdin is not None
        with contextlib.suppress(OSError):  # it has ended already
            self._process.stdin.write(f"{job}\n")
            self._process.stdin.flush()

    def check(self) -> None:
        """Warn if it has ended too early."""
        if self._process is not None and self._process.poll() is not None:
            self.finish()

    def finish(self) -> None:
        """Let it send the last metrics, for a limited time."""
        if self._process is None:
            return
        late = f"the last metrics have not arrived in {FINISH_SECONDS} s"
        try:
            reason, _ = self._process.communicate(timeout=FINISH_SECONDS + 5)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.communicate()
            reason = late
        code = self._process.returncode
        if code:
            self._give_up(reason or (late if code == -signal.SIGALRM else f"exit code {code}"))
        self._process = None

    def _give_up(self, reason: str) -> None:
        self._process = None
        logger.warning("no longer tracked by %s: %s", self._tracker, " ".join(reason.split()))


class Tracker(TrackerProcess):
    """One run directory, as the journal sees it."""

    def __init__(self, name: str, directory: Path) -> None:
        """Tell the tracker ``name`` of the run in ``directory``."""
        super().__init__(name, [directory])

    def append(self, report: IterationReport) -> None:
        """Warn if the process has ended; it reads the rows itself."""
        del report
        self.check()

    def close(self) -> None:
        """Let it send the last metrics, for a limited time."""
        self.finish()
