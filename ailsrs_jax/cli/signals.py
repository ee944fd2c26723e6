"""Stop in an orderly way when a person or the system asks to."""

import contextlib
import os
import signal
import socket
import sys
import threading

SIGNALS = (signal.SIGINT, signal.SIGTERM)
SHOW_CURSOR = b"\x1b[?25h"
NOTE = ": stopping; once more to stop at once, without saving"


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
        """Return whether a signal has arrived."""
        return self.received is not None

    def __enter__(self) -> "StopSignals":
        self._listener, self._teller = socket.socketpair()
        self._teller.setblocking(False)  # set_wakeup_fd requires it
        # Signals that are ignored already, as under nohup, stay ignored.
        handled = [number for number in SIGNALS if signal.getsignal(number) != signal.SIG_IGN]
        self._handlers = {number: signal.signal(number, lambda *_: None) for number in handled}
        self._wakeup_fd = signal.set_wakeup_fd(self._teller.fileno())
        threading.Thread(target=self._listen, name="signals", daemon=True).start()
        return self

    def __exit__(self, *exception: object) -> None:
        signal.set_wakeup_fd(self._wakeup_fd)
        for number, handler in self._handlers.items():
            signal.signal(number, handler)
        self._teller.close()  # this ends the thread

    def _listen(self) -> None:
        with self._listener:
            while number := self._listener.recv(1):
                if number[0] not in self._handlers:
                    continue
                if self.received is not None:
                    if sys.__stdout__ is not None and sys.__stdout__.isatty():
                        os.write(1, SHOW_CURSOR)  # a progress bar has hidden it
                    os._exit(128 + number[0])
                self.received = signal.Signals(number[0])
                # Written directly, because the display may be busy when the next signal arrives.
                with contextlib.suppress(OSError):  # standard error may be closed
                    os.write(2, f"\n{self.received.name}{NOTE}\n".encode())
