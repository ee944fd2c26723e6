"""The heaps of the program's threads."""

import os
import subprocess
import sys

import pytest

# Threads that allocate at the same time, and then the heaps that malloc_info lists.
MANY_THREADS = """
import ctypes, os, sys, threading
if sys.argv[1] == "bounded":
    from ailsrs_jax.__main__ import bound_heaps
    bound_heaps()
together = threading.Barrier(32)
def allocate():
    together.wait()
    kept = [bytes(1000) for _ in range(1000)]
    together.wait()
threads = [threading.Thread(target=allocate) for _ in range(32)]
for thread in threads: thread.start()
for thread in threads: thread.join()
c = ctypes.CDLL(None)
c.fdopen.restype = ctypes.c_void_p
c.malloc_info(0, ctypes.c_void_p(c.fdopen(1, b"w")))
c.fflush(None)
"""


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="needs glibc")
@pytest.mark.parametrize("bounded", [True, False])
def test_threads_share_heaps(bounded: bool) -> None:
    words = [sys.executable, "-c", MANY_THREADS, "bounded" if bounded else "free"]
    environment = {name: x for name, x in os.environ.items() if name != "MALLOC_ARENA_MAX"}
    listed = subprocess.run(words, env=environment, capture_output=True, check=True).stdout
    number = listed.count(b"<heap nr=")
    assert (number <= (os.cpu_count() or 1)) == bounded, number
