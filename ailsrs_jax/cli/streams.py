"""Standard output and error of a program that goes on when it cannot print."""

import contextlib
import io
import signal
import sys
from collections.abc import Iterator
from typing import Any


class _Stream(io.FileIO):
    """A stream that drops what it cannot write, and remembers why."""

    problem: OSError | None = None

    def write(self, content: Any, /) -> int:
        if self.problem is None:
            try:
                return super().write(content)
            except OSError as error:
                self.problem = error
        return len(content)


_streams: list[_Stream] = []


def reader_has_gone() -> bool:
    """Tell whether nobody reads any more what this program prints, as after ``| head``."""
    return any(isinstance(stream.problem, BrokenPipeError) for stream in _streams)


@contextlib.contextmanager
def forgiving_streams() -> Iterator[None]:
    """Let a program go on when it cannot print; it then exits with a code that says so.

    A character that the encoding lacks is printed as an escape.
    """
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is not None:  # as it is if it was closed from the start
            raw = _Stream(stream.fileno(), "w", closefd=False)
            text = io.TextIOWrapper(
                io.BufferedWriter(raw),
                stream.encoding,
                "backslashreplace",
                line_buffering=stream.line_buffering,
            )
            setattr(sys, name, text)
            _streams.append(raw)
    code: Any = 0
    try:
        yield
    except SystemExit as end:
        code = end.code or 0
    if sys.stdout is not None:
        sys.stdout.flush()
    problems = [stream.problem for stream in _streams if stream.problem is not None]
    if reader_has_gone():
        code = code or 128 + signal.SIGPIPE
    elif problems:
        print(f"ailsrs: cannot print: {problems[0].strerror}", file=sys.stderr)
        code = code or 2
    sys.exit(code)
