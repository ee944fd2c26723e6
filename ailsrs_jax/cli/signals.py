"""Stopping in an orderly way when the system or a person asks."""

import contextlib
import os
import signal
import socket
import sys
import threading
from types import TracebackType

SIGNALS = (signal.SIGINT, signal.SIGTERM)
SHOW_CURSOR = b"\x1b[?25h"
NOTE = ": stopping after this iteration; once more to stop at once, without saving"


class StopSignals:
    """Whether a signal has asked to stop; a context manager, and the ``stop`` of a run.

    The first signal is taken note of, and the second ends the process at once. Python runs handlers
    between two of its own instructions, of which a compiled iteration has none for minutes. So a
    thread listens, which the interpreter tells of a signal as it arrives.
    """

    def __init__(self) -> None:
        self.received: signal.Signals | None = None

    def __call__(self) -> bool:
        """Whether it has."""
        return self.received is not None

    def __enter__(self) -> "StopSignals":
        self._listener, self._teller = socket.socketpair()
        self._teller.setblocking(False)  # as is required of what a handler writes to
        # What is ignored already, as by nohup, stays so.
        handled = [number for number in SIGNALS if signal.getsignal(number) != signal.SIG_IGN]
        self._handlers = {number: signal.signal(number, lambda *_: None) for number in handled}
        self._wakeup_fd = signal.set_wakeup_fd(self._teller.fileno())
        threading.Thread(target=self._listen, name="signals", daemon=True).start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        signal.set_wakeup_fd(self._wakeup_fd)
        for number, handler in self._handlers.items():
            signal.signal(number, handler)
        self._teller.close()  # which ends the thread

    def _listen(self) -> None:
        with self._listener:
            while number := self._listener.recv(1):
                if number[0] not in self._handlers:
                    continue
                if self.received is not None:
                    if sys.__stdout__ is not None and sys.__stdout__.isatty():
                        os.write(1, SHOW_CURSOR)  # which a progress bar has hidden
                    os._exit(128 + number[0])
                self.received = signal.Signals(number[0])
                # At once, past all that draws on the terminal: the next signal may be there.
                with contextlib.suppress(OSError):  # nobody reads any longer
                    os.write(2, f"\n{self.received.name}{NOTE}\n".encode())
