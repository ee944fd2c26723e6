"""Functions on the host that a program calls, in several threads."""

import jax
import numpy as np
import pytest

from ailsrs_jax.host_calls import host_call, host_errors, interrupted, interruptible


def fail(x: np.ndarray) -> np.ndarray:
    raise ValueError(f"no {x}")


def test_a_failure_reaches_every_block() -> None:
    """It gives zeros, and nobody knows which block they are in; so none goes on with them."""
    first, second = host_errors(), host_errors()
    first.__enter__()
    second.__enter__()
    result = host_call(fail, jax.ShapeDtypeStruct((), np.float32), np.float32(3))
    assert float(result) == 0.0
    for block in (first, second):
        with pytest.raises(ValueError, match=r"no 3\.0"):
            block.__exit__(None, None, None)


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
