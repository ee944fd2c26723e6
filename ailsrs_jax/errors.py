"""The one exception that reports a user's mistake."""


class UserError(ValueError):
    """What the user handed in is wrong; the message says what, and what to do about it.

    The command line prints the message as one line and exits with code 2. Everything else that is
    raised is a defect of this package and keeps its traceback.
    """


def one_line(error: Exception) -> str:
    """What kind of error it is, and the first line of what it says."""
    return f"{type(error).__name__}: {next(iter(str(error).splitlines()), '')}"
