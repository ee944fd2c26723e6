"""Detection of side effects that reading a file must not have."""

import contextlib
import os
import resource
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

MEMORY = 4 * 2**30  # bytes of address space that reading may add to the process

FORBIDDEN = (
    *("pickle.", "os.system", "os.exec", "os.fork", "os.posix_spawn"),
    *("subprocess.", "socket.connect", "webbrowser."),
)
WRITES = ("os.mkdir", "os.remove", "os.rename", "os.link", "os.symlink", "shutil.move")


class Watcher:
    """Records, by Python's audit events, unpickling, new processes, and writes elsewhere."""

    def __init__(self, directory: Path) -> None:
        self.events: list[str] = []
        self._watching = False
        jax_cache = os.environ.get("JAX_COMPILATION_CACHE_DIR", os.devnull)
        self._allowed = (str(directory), jax_cache, os.devnull, "/proc/self")
        sys.addaudithook(self._hear)

    @contextlib.contextmanager
    def watch(self) -> Iterator[None]:
        """Record the events of the block."""
        self.events, self._watching = [], True
        try:
            yield
        finally:
            self._watching = False

    def _hear(self, event: str, arguments: tuple[Any, ...]) -> None:
        if not self._watching:
            return
        if event.startswith(FORBIDDEN):
            self.events.append(f"{event} {arguments!r:.200}")
        writes = event in WRITES
        if event == "open" and isinstance(arguments[2], int):
            writes = bool(arguments[2] & (os.O_WRONLY | os.O_RDWR | os.O_CREAT))
        path = arguments[0] if arguments else None
        if writes and isinstance(path, str | bytes | os.PathLike):
            absolute = os.path.abspath(os.fsdecode(path))  # noqa: PTH100 (resolve() opens links)
            if not absolute.startswith(self._allowed):
                self.events.append(f"{event} {absolute}")


@contextlib.contextmanager
def limited_memory() -> Iterator[None]:
    """Raise MemoryError in the block beyond :data:`MEMORY`."""
    size = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (size + MEMORY, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))
