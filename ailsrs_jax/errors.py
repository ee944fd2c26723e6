"""The one exception that reports a user's mistake."""

import difflib
from collections.abc import Iterable

LONGEST = 1000  # characters of a message


class UserError(ValueError):
    """What the user handed in is wrong; the message says what, and what to do about it.

    The command line prints the message as one line and exits with code 2. Everything else that is
    raised is a defect of this package and keeps its traceback.
    """

    def __init__(self, message: str) -> None:
        # Names and values come from files too, and could break the line or drive the terminal.
        line = "".join(c if c.isprintable() else ascii(c)[1:-1] for c in message[: LONGEST + 1])
        super().__init__(line if len(line) <= LONGEST else f"{line[: LONGEST - 3]}...")


class InUseError(UserError):
    """Another process is at it."""


def one_line(error: Exception) -> str:
    """What kind of error it is, and the first line of what it says."""
    text = next(iter(str(error).splitlines()), "")
    return f"{type(error).__name__}: {text if len(text) <= 300 else f'{text[:297]}...'}"


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """What to add to a complaint about an unknown name: the nearest of those that are known."""
    nearest = difflib.get_close_matches(name, list(known), n=1)
    return f" (did you mean {nearest[0]}?)" if nearest else ""
