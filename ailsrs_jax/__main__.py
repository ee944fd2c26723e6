"""The program ``ailsrs``, also as ``python -m ailsrs_jax``."""

import contextlib
import ctypes
import os

from ailsrs_jax.cli.signals import end_on_ctrl_c
from ailsrs_jax.cli.streams import forgiving_streams

M_ARENA_MAX = -8  # of glibc's malloc.h


def main() -> None:
    """Run the command line; from now on Ctrl-C ends it in one line."""
    end_on_ctrl_c()
    bound_heaps()
    with forgiving_streams():
        from ailsrs_jax.cli.main import main  # takes half a second

        main()


def bound_heaps() -> None:
    """Let glibc's ``malloc`` use one heap for each core, unless the user has chosen a number.

    By default there are up to eight for each core, and each keeps what it once needed. Threads that
    write checkpoints come and go, and use one after the other, so memory would grow for hours.
    """
    if "MALLOC_ARENA_MAX" not in os.environ:
        with contextlib.suppress(AttributeError):  # another C library
            ctypes.CDLL(None).mallopt(M_ARENA_MAX, os.cpu_count() or 1)


if __name__ == "__main__":
    main()
