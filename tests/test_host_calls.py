"""Functions on the host that a program calls, in several threads."""

import threading

import jax
import numpy as np
import pytest

from ailsrs_jax.host_calls import host_call, host_errors, interrupted, interruptible


def fail(x: np.ndarray) -> np.ndarray:
    raise ValueError(f"no {x}")


def test_a_failure_reaches_the_block_of_its_own_thread() -> None:
    begun, ended = threading.Event(), list[str]()

    def innocent() -> None:
        begun.set()
        with host_errors():  # waits for its turn
            ended.append("well")

    other = threading.Thread(target=innocent)

    def failing() -> None:
        with host_errors():
            other.start()
            begun.wait()
            result = host_call(fail, jax.ShapeDtypeStruct((), np.float32), np.float32(3))
            assert float(result) == 0.0
            assert not ended

    with pytest.raises(ValueError, match=r"no 3\.0"):
        failing()
    other.join()
    assert ended == ["well"]


def test_blocks_end_in_any_order() -> None:
    stopped = {"first": False, "second": False}
    first, second = (interruptible(lambda name=name: stopped[name]) for name in stopped)
    first.__enter__()
    second.__enter__()
    stopped["first"] = True
    assert interrupted()
    first.__exit__(None, None, None)
    assert not interrupted()
    stopped["second"] = True
    assert interrupted()
    second.__exit__(None, None, None)
    assert not interrupted()
