"""The exception that reports a user's mistake, and helpers for its message."""

import contextlib
import difflib
from collections.abc import Callable, Iterable, Iterator

LONGEST = 1000  # characters of a message


class UserError(ValueError):
    """A user's mistake; the message says what is wrong and what to do about it.

    The command line prints the message as one line and exits with code 2. Any other exception is a
    defect of this package and keeps its traceback.
    """

    def __init__(self, message: str) -> None:
        # Names and values from files could break the line or send commands to the terminal.
        line = "".join(c if c.isprintable() else ascii(c)[1:-1] for c in message[: LONGEST + 1])
        super().__init__(line if len(line) <= LONGEST else f"{line[: LONGEST - 3]}...")


class InUseError(UserError):
    """Another process is writing to this directory."""


def one_line(error: Exception) -> str:
    """Return the type of ``error`` and the first line of its message."""
    text = next(iter(str(error).splitlines()), "")
    return f"{type(error).__name__}: {text if len(text) <= 300 else f'{text[:297]}...'}"


@contextlib.contextmanager
def refusing(problem: str) -> Iterator[None]:
    """Turn any exception of the block into a UserError that begins with ``problem``.

    It surrounds code of other libraries and of users, which may raise anything.
    """
    try:
        yield
    except UserError:
        raise
    except Exception as error:
        raise UserError(f"{problem}: {one_line(error)}") from error


@contextlib.contextmanager
def os_errors(problem: str) -> Iterator[None]:
    """Turn an OSError of the block into a UserError that begins with ``problem``."""
    try:
        yield
    except OSError as error:
        raise UserError(f"{problem}: {error.strerror or error}") from error


def requirement(source: str) -> Callable[[bool, str], None]:
    """Return ``require(condition, problem)``, which raises UserError if the condition is false.

    The message is ``source`` and the problem.
    """

    def require(condition: bool, problem: str) -> None:
        if not condition:
            raise UserError(f"{source}: {problem}")

    return require


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """Return a hint at the known name that is most similar to ``name``, or an empty string."""
    nearest = difflib.get_close_matches(name, list(known), n=1)
    return f" (did you mean {nearest[0]}?)" if nearest else ""
