"""Silence for MuJoCo's C library."""

import contextlib
import threading
from collections.abc import Iterator

import mujoco

_one_at_a_time = threading.RLock()  # the process has a single handler


@contextlib.contextmanager
def without_warnings() -> Iterator[None]:
    """Keep MuJoCo from printing its warnings, and from logging them to the working directory."""
    with _one_at_a_time:
        previous = mujoco.get_mju_user_warning()
        mujoco.set_mju_user_warning(lambda _: None)
        try:
            yield
        finally:
            mujoco.set_mju_user_warning(previous)
