"""The one exception that reports a user's mistake."""


class UserError(ValueError):
    """What the user handed in is wrong; the message says what, and what to do about it.

    The command line prints the message as one line and exits with code 2. Everything else that is
    raised is a defect of this package and keeps its traceback.
    """
