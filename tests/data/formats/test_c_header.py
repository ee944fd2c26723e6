"""A policy as C, compiled and compared with NumPy."""

import ctypes
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

import ailsrs_jax as ail
from ailsrs_jax.data.policies import SavedLinearPolicy, SavedPolicy

CALLABLE = """
#include "policy.h"
int sizes[2] = {POLICY_NUM_OBSERVATIONS, POLICY_NUM_ACTIONS};
void act(const double *observation, double *action) { policy_act(observation, action); }
"""


def linear() -> SavedPolicy:
    rng = np.random.default_rng(0)
    return SavedLinearPolicy(
        weights=rng.normal(size=(3, 11)),
        mean=rng.normal(size=11),
        std=rng.uniform(0.1, 2.0, 11),
        action_low=np.array([-1.0, -0.5, -2.0]),
        action_high=np.array([1.0, 0.25, 2.0]),
        env_id="*/ int injected; /*",
    )


@pytest.mark.skipif(shutil.which("cc") is None, reason="needs a C compiler")
@pytest.mark.parametrize("kind", ["linear", "neural"])
def test_the_c_function_acts_as_numpy(kind: str, in_tmp_path: Path) -> None:
    policy = linear() if kind == "linear" else ail.load_expert("hopper")
    policy.save("policy.h")
    Path("policy.c").write_text(CALLABLE)
    strict = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic"]
    subprocess.run(
        ["cc", *strict, "-shared", "-fPIC", "policy.c", "-o", "policy.so", "-lm"], check=True
    )
    library = ctypes.CDLL(str(in_tmp_path / "policy.so"))
    assert list((ctypes.c_int * 2).in_dll(library, "sizes")) == [11, 3]
    assert not hasattr(library, "injected")
    numbers = ctypes.POINTER(ctypes.c_double)
    observations = np.random.default_rng(1).normal(scale=3.0, size=(50, 11))
    observations[0, 3] = np.nan  # a broken sensor must not look like an action
    for observation in observations:
        action = np.empty(3)
        library.act(observation.ctypes.data_as(numbers), action.ctypes.data_as(numbers))
        np.testing.assert_allclose(action, policy(observation), rtol=1e-12, atol=1e-12)


def test_a_header_is_not_read(in_tmp_path: Path) -> None:
    linear().save("policy.h")
    with pytest.raises(ail.UserError, match=r"policy\.h: \.h is for other programs"):
        ail.load_policy("policy.h")
