"""Any number of simulations, thousands in turn, forks, and interrupts."""

import subprocess
import sys

import pytest

SETUP = """
import os
import signal
import sys
import threading

import jax
import jax.numpy as jnp
import numpy as np

from ailsrs_jax.envs.registry import make_env

env = make_env(*sys.argv[1:])


@jax.jit
def simulate(keys, num_steps=10):
    states = jax.vmap(env.reset)(keys)
    actions = jax.random.uniform(keys[0], (num_steps, len(keys), env.action_size), minval=-1.0)
    step = jax.vmap(env.step)
    return jax.lax.scan(lambda states, each: (step(states, each), None), states, actions)[0]


def observations(num_envs, seed=0):
    keys = jax.random.split(jax.random.key(seed), num_envs)
    return np.asarray(simulate(keys).obs)
"""

ANY_NUMBER = """
for num_envs in (1, 2, 3, 47, 4096):
    assert np.isfinite(observations(num_envs)).all(), num_envs
"""

# Thousands of simulations, 32 at a time, start no additional threads.
MANY_EPISODES = """
observations(32)
before = threading.active_count(), len(os.listdir("/proc/self/task"))
for seed in range(32):
    observations(32, seed)
assert (threading.active_count(), len(os.listdir("/proc/self/task"))) == before
"""

# The child process has none of the threads, so it may only exit or execute another program.
FORK = """
expected = observations(8)
for command in ([], ["true"]):
    child = os.fork()
    if child == 0:
        os.execvp(command[0], command) if command else os._exit(0)
    assert os.waitpid(child, 0)[1] == 0
    np.testing.assert_array_equal(observations(8), expected)
"""

INTERRUPT = """
signal.signal(signal.SIGALRM, signal.default_int_handler)
expected = observations(256)
interrupted = 0
for delay in np.linspace(0.001, 0.1, 10):
    signal.setitimer(signal.ITIMER_REAL, delay)
    try:
        for _ in range(1000):
            observations(256)
    except (KeyboardInterrupt, ValueError):  # JAX raises ValueError in a callback
        interrupted += 1
    np.testing.assert_array_equal(observations(256), expected)
assert interrupted == 10
"""


def run(program: str, env: str, physics: str = "mujoco") -> None:
    command = [sys.executable, "-W", "ignore:os.fork", "-c", SETUP + program, env, physics]
    subprocess.run(command, check=True, timeout=600)


@pytest.mark.slow
@pytest.mark.parametrize("env", ["hopper", "ant"])  # one task for each pool of threads
def test_the_c_engine_survives(env: str) -> None:
    run(ANY_NUMBER + MANY_EPISODES + FORK + INTERRUPT, env)


@pytest.mark.slow
def test_mjx_simulates_any_number() -> None:
    run(ANY_NUMBER, "hopper", "mjx")
