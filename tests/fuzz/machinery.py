"""Trying inputs, in a process of limited memory that is watched."""

import contextlib
import multiprocessing
import os
import resource
import shutil
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

from ailsrs_jax.errors import UserError
from tests.fuzz.mutations import Rng
from tests.fuzz.readers import READERS, Reader

MEMORY = 4 * 2**30  # bytes of address space beyond what the imports take


CPU_SECONDS = 20  # after which an input hangs,


WALL_SECONDS = 600  # or, where it only waits: the machine may be busy


class Watcher:
    """Notes what an input should not be able to bring about, by Python's audit events."""

    FORBIDDEN = ("pickle.", "os.system", "os.exec", "os.fork", "os.posix_spawn")

    def __init__(self, directory: Path) -> None:
        self.events: list[str] = []
        self.watching = False
        self._directory = str(directory)
        sys.addaudithook(self._hear)

    def _hear(self, event: str, arguments: tuple[Any, ...]) -> None:
        if not self.watching:
            return
        if event.startswith((*self.FORBIDDEN, "subprocess.", "socket.connect", "webbrowser.")):
            self.events.append(f"{event} {arguments!r:.200}")
        writes = event in (
            "os.mkdir",
            "os.remove",
            "os.rename",
            "os.link",
            "os.symlink",
            "shutil.move",
        )
        if event == "open" and isinstance(arguments[2], int):
            writes = bool(arguments[2] & (os.O_WRONLY | os.O_RDWR | os.O_CREAT))
        path = arguments[0] if arguments else None
        if writes and isinstance(path, str | bytes | os.PathLike):
            absolute = os.path.abspath(os.fsdecode(path))  # noqa: PTH100 (resolve() opens links)
            if not absolute.startswith((self._directory, os.devnull, "/proc/self")):
                self.events.append(f"{event} {absolute}")


def try_one(reader: Reader, path: Path, seed: str, watcher: Watcher) -> tuple[str, str]:
    """What came of one input: ``value``, ``refused`` or something that should not be."""
    watcher.events = []
    try:
        reader.make(path, Rng(seed))
        watcher.watching = True
        reader.read(path)
        outcome, text = "value", ""
    except UserError as error:
        outcome, text = "refused", str(error)
        if len(text.splitlines()) != 1 or len(text) > 1000 or not text.isprintable():
            outcome = "not one line"
    except BaseException:
        outcome, text = "traceback", traceback.format_exc(limit=-6)
    finally:
        watcher.watching = False
        shutil.rmtree(path, ignore_errors=True)
        path.unlink(missing_ok=True)
    if watcher.events:
        outcome, text = "outside", "; ".join(watcher.events)
    return outcome, text


def work(name: str, first: int, last: int, directory: Path, results: Any) -> None:
    """Try inputs in a process of its own, and tell of each."""
    import jax

    jax.config.update("jax_platforms", "cpu")
    os.chdir(directory)
    os.environ["MINARI_DATASETS_PATH"] = str(directory / "datasets")
    os.environ["XDG_CACHE_HOME"] = str(directory / "cache")
    devnull = os.open(directory / "stderr", os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    os.dup2(devnull, 2)
    warnings.simplefilter("ignore")
    watcher = Watcher(directory)
    reader = READERS[name]
    with contextlib.suppress(Exception):  # imports, and what is made once
        reader.make(directory / "warm", Rng("warm"))
        reader.read(directory / "warm")
    size = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (size + MEMORY, resource.RLIM_INFINITY))
    for number in range(first, last):
        results.send((number, None, ""))
        outcome, text = try_one(reader, directory / "input", f"{name} {number}", watcher)
        results.send((number, outcome, text[:2000]))


def answers(process: Any, results: Any) -> bool:
    """Whether the process says something before it has run or waited for too long."""

    def cpu_seconds() -> float:
        fields = Path(f"/proc/{process.pid}/stat").read_text().rpartition(")")[2].split()
        return sum(map(int, fields[11:13])) / os.sysconf("SC_CLK_TCK")

    started, before = time.monotonic(), cpu_seconds()
    while not results.poll(5):
        waited, ran = time.monotonic() - started, cpu_seconds() - before
        if waited > WALL_SECONDS or ran > CPU_SECONDS:
            return False
    return True


def fuzz(name: str, first: int, last: int, say: Callable[[str], None]) -> Counter[str]:
    """Inputs ``first`` to ``last`` of one reader; counts of outcomes."""
    counts: Counter[str] = Counter()
    context = multiprocessing.get_context("spawn")
    while first < last:
        with tempfile.TemporaryDirectory() as directory:
            results, sender = context.Pipe(duplex=False)
            process = context.Process(
                target=work, args=(name, first, last, Path(directory), sender)
            )
            process.start()
            sender.close()
            number = first
            try:
                while first < last:
                    if not answers(process, results):
                        counts["hang"] += 1
                        say(f"{name} {number}: hang")
                        break
                    number, outcome, text = results.recv()
                    if outcome is None:
                        continue
                    counts[outcome] += 1
                    first = number + 1
                    if outcome not in ("value", "refused"):
                        say(f"{name} {number}: {outcome}: {text}")
            except EOFError:
                process.join()
                counts["crash"] += 1
                say(f"{name} {number}: the process ended with {process.exitcode}")
            else:
                process.kill()
                process.join()
            if first < last:
                first = number + 1
    return counts
