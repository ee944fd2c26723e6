"""JAX 0.10 deadlocks in MJX with more than some 900 environments on a 2-core CPU."""

import subprocess
import sys

import pytest

PROGRAM = """
import jax
import pytest
from ailsrs_jax.envs.registry import make_env

env = make_env("halfcheetah", "mjx")
state = jax.jit(jax.vmap(env.reset))(jax.random.split(jax.random.key(0), 1280))
step = jax.jit(jax.vmap(env.step))
for _ in range(3):
    state = step(state, jax.numpy.ones((1280, 6)))
assert bool(jax.numpy.isfinite(state.obs).all())
"""


@pytest.mark.slow
def test_1280_environments_do_not_deadlock() -> None:
    subprocess.run([sys.executable, "-c", PROGRAM], check=True, timeout=240)
