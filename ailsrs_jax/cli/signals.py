"""Stop in an orderly way when a person or the system asks to."""

import contextlib
import os
import signal
import socket
import threading
from collections.abc import Iterator
from typing import NoReturn

from ailsrs_jax.cli.streams import reader_has_gone

SIGNALS = (signal.SIGINT, signal.SIGTERM)
SHOW_CURSOR = b"\x1b[?25h"
NOTE = ": stopping; once more to stop at once, without saving"


def end_on_ctrl_c() -> None:
    """Let Ctrl-C end the process, in one line.

    Python's own handler raises KeyboardInterrupt, which is lost in callbacks of the garbage
    collector. JAX has one.
    """
    if signal.getsignal(signal.SIGINT) != signal.SIG_IGN:  # as under nohup
        signal.signal(signal.SIGINT, _interrupt)


@contextlib.contextmanager
def keyboard_interrupts() -> Iterator[None]:
    """Let Ctrl-C raise KeyboardInterrupt, for code that has to end other processes."""
    handler = signal.getsignal(signal.SIGINT)
    if handler != signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, handler)


def _interrupt(number: int, _: object) -> None:
    with contextlib.suppress(OSError):  # standard error may be closed
        os.write(2, b"ailsrs: interrupted\n")
    _end(number)


def _end(number: int) -> NoReturn:
    for descriptor in (1, 2):
        if os.isatty(descriptor):
            os.write(descriptor, SHOW_CURSOR)  # a progress bar has hidden it
    os._exit(128 + number)


class StopSignals:
    """Whether a signal has requested a stop; a context manager, and the ``stop`` of a run.

    The first signal requests a stop, at the latest after this iteration. The second ends the
    process at once.
    Python runs signal handlers only between two of its own instructions, which can be minutes apart
    while a compiled iteration runs. So a thread listens on a socket that the interpreter writes to
    as soon as a signal arrives.
    """

    def __init__(self) -> None:
        self.received: signal.Signals | None = None

    def __call__(self) -> bool:
        """Return whether a signal has arrived; it counts as SIGPIPE if nobody reads the output."""
        if self.received is None and reader_has_gone():
            self.received = signal.SIGPIPE
        return self.received is not None

    def __enter__(self) -> "StopSignals":
        self._listener, self._teller = socket.socketpair()
        self._teller.setblocking(False)  # set_wakeup_fd requires it
        # Signals that are ignored already, as under nohup, stay ignored.
        self._handlers = {n: h for n in SIGNALS if (h := signal.getsignal(n)) != signal.SIG_IGN}
        threading.Thread(target=self._listen, name="signals", daemon=True).start()
        # This order, here and at the end, loses no signal.
        self._wakeup_fd = signal.set_wakeup_fd(self._teller.fileno())
        for number in self._handlers:
            signal.signal(number, lambda *_: None)
        return self

    def __exit__(self, *exception: object) -> None:
        for number, handler in self._handlers.items():
            signal.signal(number, handler)
        signal.set_wakeup_fd(self._wakeup_fd)
        self._teller.close()  # this ends the thread

    def _listen(self) -> None:
        with self._listener:
            while number := self._listener.recv(1):
                if number[0] not in self._handlers:
                    continue
                if self.received is not None:
                    _end(number[0])
                self.received = signal.Signals(number[0])
                # Written directly, because the display may be busy when the next signal arrives.
                with contextlib.suppress(OSError):  # standard error may be closed
                    os.write(2, f"\n{self.received.name}{NOTE}\n".encode())
