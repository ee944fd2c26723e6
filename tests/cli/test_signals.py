"""Ctrl-C at any moment, also before a run has begun."""

import signal
import subprocess
import sys

import pytest

from ailsrs_jax.cli.signals import end_on_ctrl_c, keyboard_interrupts

# Ctrl-C while a module is imported, inside of a callback or outside.
PROGRAM = """
import gc, os, runpy, signal, sys

def interrupt(*_):
    os.kill(os.getpid(), signal.SIGINT)

def watch(event, arguments):
    if event == "import" and arguments[0] == {module!r}:
        {when}

signal.signal(signal.SIGINT, signal.default_int_handler)  # ignored in background jobs
sys.addaudithook(watch)
sys.argv = ["ailsrs", "report", "nowhere"]
runpy.run_module("ailsrs_jax", run_name="__main__")
"""


@pytest.mark.parametrize("module", ["tyro", "jax"])
@pytest.mark.parametrize("when", ["interrupt()", "gc.callbacks.append(interrupt); gc.collect()"])
def test_ctrl_c_while_modules_are_imported(module: str, when: str) -> None:
    """Python ignores exceptions in callbacks of the garbage collector."""
    program = PROGRAM.format(module=module, when=when)
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert (ended.returncode, ended.stdout, ended.stderr) == (130, "", "ailsrs: interrupted\n")


def test_what_ctrl_c_does_changes_only_for_a_while_and_not_under_nohup() -> None:
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # ignored in a background job
    try:
        end_on_ctrl_c()
        ending = signal.getsignal(signal.SIGINT)
        with pytest.raises(KeyboardInterrupt), keyboard_interrupts():
            signal.raise_signal(signal.SIGINT)
        assert signal.getsignal(signal.SIGINT) is ending is not before
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        end_on_ctrl_c()
        with keyboard_interrupts():
            assert signal.getsignal(signal.SIGINT) == signal.SIG_IGN
    finally:
        signal.signal(signal.SIGINT, before)
