"""Whole episodes of Gymnasium environments in worker processes."""

import functools
import importlib
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import gymnasium
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ailsrs_jax.components.policy import LinearPolicy, MlpPolicy, repeated
from ailsrs_jax.envs.gymnasium_env import GymnasiumEnv
from ailsrs_jax.envs.interface import action_range, starts_at_observations
from ailsrs_jax.errors import UserError
from ailsrs_jax.host_calls import Interrupted, host_errors, interruptible
from ailsrs_jax.trainers.parts.episodes import Episodes
from ailsrs_jax.trainers.parts.rollout import simulate
from ailsrs_jax.workers.process import ProcessWorker
from tests.workers import environments

GAIN = np.array([[-1.0, -1.5]], np.float32)


def controller(env: GymnasiumEnv, num_policies: int) -> LinearPolicy:
    n = env.observation_size
    weights = jnp.array(GAIN) * jnp.linspace(0.1, 1.0, num_policies)[:, None, None]
    policy = LinearPolicy(weights[0], jnp.zeros(n), jnp.ones(n), *action_range(env))
    return policy.with_weights(weights)


def run(
    env: GymnasiumEnv, num_episodes: int = 6, noise: Any = None, starts: Any = None
) -> Episodes:
    if starts is None:
        starts = jax.random.split(jax.random.key(0), num_episodes)
    with host_errors():
        program = jax.jit(lambda policies: simulate(env, policies, starts, 50, noise=noise))
        episodes: Episodes = jax.block_until_ready(program(controller(env, num_episodes)))
    return episodes


def make(name: str) -> Any:
    """A function that makes the environment."""

    def maker() -> gymnasium.Env:
        return getattr(environments, name)()

    maker.__name__ = name
    return maker


@pytest.fixture(scope="module")
def mass() -> GymnasiumEnv:
    return GymnasiumEnv(make("Mass"), workers=2)


def assert_same(mine: Episodes, theirs: Episodes) -> None:
    for one, other in zip(jax.tree.leaves(mine), jax.tree.leaves(theirs), strict=True):
        np.testing.assert_array_equal(one, other)


def test_they_are_those_of_a_plain_loop(mass: GymnasiumEnv) -> None:
    assert (mass.observation_size, mass.action_size, mass.time_limit) == (2, 1, None)
    assert (mass.action_low.tolist(), mass.action_high.tolist()) == ([-2.0], [2.0])
    noise = 2 * jax.random.normal(jax.random.key(1), (6, 50, 1))
    episodes = run(mass, noise=noise, starts=mass.resets(range(6)))
    env, policies = environments.Mass(), controller(mass, 6)
    for i in range(6):
        observation, _ = env.reset(seed=i)
        for step in range(int(episodes.lengths[i])):
            np.testing.assert_allclose(episodes.observations[i, step], observation, atol=1e-6)
            action = np.clip(policies.weights[i] @ observation + noise[i, step], -2, 2)
            np.testing.assert_allclose(episodes.actions[i, step], action, rtol=1e-5, atol=1e-6)
            observation, reward, *_ = env.step(np.asarray(episodes.actions[i, step]))
            np.testing.assert_allclose(episodes.env_rewards[i, step], reward, rtol=1e-5)
        np.testing.assert_allclose(episodes.final_observations[i], observation, atol=1e-6)
    assert not episodes.diverged.any()


def test_an_environment_may_move_what_it_has_handed_out(mass: GymnasiumEnv) -> None:
    assert_same(run(GymnasiumEnv(make("InPlace"), workers=1)), run(mass))


def test_the_number_of_workers_does_not_matter(mass: GymnasiumEnv) -> None:
    alone = GymnasiumEnv(make("Mass"), workers=1)
    assert_same(run(alone), run(mass))


def test_networks_act_as_in_jax(mass: GymnasiumEnv) -> None:
    network = MlpPolicy(
        weights=(jnp.array([[1.0, -1.0], [0.5, 2.0], [0.0, 1.0]]), jnp.array([[0.3, -1.0, 0.2]])),
        biases=(jnp.array([0.1, 0.0, -0.3]), jnp.array([0.2])),
        mean=jnp.array([0.1, -0.1]),
        std=jnp.array([2.0, 0.5]),
        action_low=jnp.array([-2.0]),
        action_high=jnp.array([2.0]),
        action_std=jnp.ones(1),
    )
    episodes = simulate(mass, repeated(network, 3), jax.random.split(jax.random.key(0), 3), 20)
    expected = jax.vmap(jax.vmap(network))(episodes.observations)
    np.testing.assert_allclose(episodes.actions, expected, rtol=1e-4, atol=1e-5)


def test_dictionaries_are_flattened(mass: GymnasiumEnv) -> None:
    starts = mass.resets(range(6))
    named = run(GymnasiumEnv(make("Named"), workers=1), starts=starts)
    np.testing.assert_allclose(
        named.observations[:, 0], run(mass, starts=starts).observations[:, 0], rtol=1e-6
    )


@pytest.mark.parametrize("name", ["gymnasium:Hopper-v5", "Placed"])
def test_demonstrated_states_to_begin_from(name: str, caplog: pytest.LogCaptureFixture) -> None:
    """Beside resets; each goes on as the episode that it was demonstrated in."""
    env = GymnasiumEnv(name.partition(":")[2] or make(name), workers=1)
    assert starts_at_observations(env)
    n = env.observation_size
    weights = 0.3 * jax.random.normal(jax.random.key(0), (env.action_size, n))
    policies = repeated(LinearPolicy(weights, jnp.zeros(n), jnp.ones(n), *action_range(env)), 2)
    resets = env.resets([5, 6])
    whole = simulate(env, policies, resets, 9)
    states = jax.vmap(env.state_at)(whole.observations[:, 4])
    starts = jax.tree.map(lambda state, reset: jnp.stack([state[0], reset[1]]), states, resets)
    later = simulate(env, policies, starts, 5)
    np.testing.assert_allclose(later.observations[0], whole.observations[0, 4:], atol=1e-3)
    np.testing.assert_array_equal(later.observations[1], whole.observations[1, :5])
    assert not caplog.text
    keys = jax.random.split(jax.random.key(0), 2)
    assert len(set(jax.vmap(env.state_at)(whole.observations[:, 4], keys).seed.tolist())) == 2


def test_what_cannot_be_put_there_is_told_once(
    mass: GymnasiumEnv, caplog: pytest.LogCaptureFixture
) -> None:
    for _ in range(2):
        assert not starts_at_observations(mass)
    assert not GymnasiumEnv("InvertedDoublePendulum-v5", workers=1).sets_observations
    assert caplog.messages == [
        "gymnasium:Mass cannot be put into a demonstrated state, so all episodes start with a "
        "reset; an environment of Gymnasium can if it has a method set_observation(observation)"
    ]


def test_names_may_say_which_module_registers_them() -> None:
    env = GymnasiumEnv("tests.workers.environments:Plain-v0", workers=1)
    assert env.time_limit == 40
    assert GymnasiumEnv(functools.partial(environments.Mass), workers=1).env_id == "gymnasium:Mass"


def test_the_module_of_an_environment_may_be_anywhere(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As beside a script that runs in another directory; if it is gone, a line says so."""
    module = tmp_path / "beside.py"
    module.write_text(
        "from tests.workers.environments import Mass\n\n\ndef maker() -> Mass:\n    return Mass()\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    beside = importlib.import_module("beside")
    assert GymnasiumEnv(beside.maker, workers=1).observation_size == 2
    module.unlink()
    with pytest.raises(UserError, match="maker: ModuleNotFoundError: No module named 'beside'; "):
        GymnasiumEnv(beside.maker, workers=1)
    monkeypatch.delitem(sys.modules, "beside")


@pytest.mark.parametrize(
    ("name", "problem"),
    [
        ("Buttons", "its actions are Discrete.* must be a Box of real numbers"),
        ("Unbounded", "give them a finite range"),
        ("Words", "it observes Text.* no vector of numbers"),
    ],
)
def test_what_is_no_vector_is_refused(name: str, problem: str) -> None:
    with pytest.raises(UserError, match=problem):
        GymnasiumEnv(make(name))


def test_unknown_names_are_refused() -> None:
    with pytest.raises(UserError, match=r"gymnasium:Nix-v0: NameNotFound.* the traceback is in "):
        GymnasiumEnv("Nix-v0")


def test_files_of_the_current_directory_are_not_imported(
    in_tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """They may come from a stranger, and nobody has named them."""
    for module in ("queue", "pygame", "mujoco"):
        Path(f"{module}.py").write_text("open('imported', 'w').close()")
    monkeypatch.delenv("PYTHONPATH", raising=False)
    assert GymnasiumEnv("Pendulum-v1", workers=1).observation_size == 3
    assert not Path("imported").exists()


def test_what_the_environment_has_started_ends_with_the_worker(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SPAWNED", str(tmp_path / "pid"))
    with (tmp_path / "log").open("wb") as log:
        worker = ProcessWorker(make("Spawning"), log)
    assert worker.answer().observation_size == 2
    status = Path("/proc", (tmp_path / "pid").read_text(), "stat")
    assert status.exists()
    worker.kill()
    deadline = time.monotonic() + 10
    while status.exists() and " Z " not in status.read_text():
        assert time.monotonic() < deadline
        time.sleep(0.05)


def test_a_function_that_cannot_be_sent_is_refused() -> None:
    lock = threading.Lock()

    def locked() -> Any:
        with lock:
            return environments.Mass()

    with pytest.raises(
        UserError, match="locked cannot be sent to a worker: TypeError: cannot pick"
    ):
        GymnasiumEnv(locked)


@pytest.mark.parametrize("workers", [0, "0", "-1", "two", "ray:", "ray:0", "dask:2"])
def test_wrong_numbers_of_workers_are_refused(workers: int | str) -> None:
    with pytest.raises(UserError, match=f"workers is '{workers}': give a number"):
        GymnasiumEnv("Pendulum-v1", workers)


def test_an_exception_is_a_line_and_a_traceback_in_a_log() -> None:
    env = GymnasiumEnv(make("Raising"), workers=2)
    with pytest.raises(
        UserError, match="Raising: ZeroDivisionError: no such force; the tr"
    ) as error:
        run(env)
    log = Path(str(error.value).rpartition(" ")[2])
    assert 'raise ZeroDivisionError("no such force")' in log.read_text()
    with pytest.raises(UserError, match="no such force"):  # again, with new workers
        run(env)


def test_nan_is_divergence() -> None:
    episodes = run(GymnasiumEnv(make("Diverging"), workers=2))
    assert episodes.diverged.any()
    assert np.isfinite(episodes.observations).all()
    assert np.array_equal(np.isnan(episodes.env_rewards).any(axis=1), episodes.diverged)
    far = run(GymnasiumEnv(make("Far"), workers=1))
    assert far.diverged.all()
    assert not far.lengths.any()


@pytest.mark.parametrize("name", ["Dying", "Hanging"])
def test_a_lost_worker_is_replaced(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, mass: GymnasiumEnv
) -> None:
    monkeypatch.setenv("MARKS", str(tmp_path))
    assert_same(run(GymnasiumEnv(make(name), workers=2, worker_timeout=4.0), 8), run(mass, 8))
    assert (tmp_path / "0").exists()


def test_an_episode_that_always_kills_its_worker(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("MARKS", raising=False)
    with pytest.raises(
        UserError, match="has ended 3 times in the same episode; what it printed is"
    ):
        run(GymnasiumEnv(make("Deadly"), workers=2), 8)


def test_it_ends_when_somebody_asks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MARKS", str(tmp_path))
    env = GymnasiumEnv(make("Hanging"), workers=1)
    started = time.monotonic()
    with pytest.raises(Interrupted), interruptible(lambda: time.monotonic() > started + 2):
        run(env, 8)
    assert time.monotonic() < started + 10


PROGRAM = """
from tests.workers.test_pool import *
env = GymnasiumEnv(make("Hanging"), workers=2)
print("ready", flush=True)
run(env, 8)
"""


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM])
def test_no_worker_outlives_the_program(number: int, tmp_path: Path) -> None:
    with subprocess.Popen(
        [sys.executable, "-c", PROGRAM],
        env={**os.environ, "MARKS": str(tmp_path)},
        stdout=subprocess.PIPE,
        cwd=Path(__file__).parents[2],
    ) as program:
        assert program.stdout is not None
        assert program.stdout.readline() == b"ready\n"
        while not (tmp_path / "0").exists():
            time.sleep(0.1)
        workers = children(program.pid)
        assert workers
        program.send_signal(number)
    deadline = time.monotonic() + 10
    while any(Path(f"/proc/{worker}").exists() for worker in workers):
        assert time.monotonic() < deadline
        time.sleep(0.1)


ON_RAY = """
from tests.workers.test_pool import *
assert_same(
    run(GymnasiumEnv(make("Dying"), workers="ray:2"), 8), run(GymnasiumEnv(make("Mass"), 1), 8)
)
with pytest.raises(UserError, match="Raising: ZeroDivisionError: no such force"):
    run(GymnasiumEnv(make("Raising"), workers="ray:2"))
print("as undisturbed")
"""


@pytest.mark.slow
def test_lost_actors_of_ray_are_replaced(tmp_path: Path) -> None:
    pytest.importorskip("ray")
    program = subprocess.run(
        [sys.executable, "-c", ON_RAY],
        env={**os.environ, "MARKS": str(tmp_path)},
        cwd=Path(__file__).parents[2],
        capture_output=True,
        check=False,
        text=True,
    )
    assert "as undisturbed\n" in program.stdout, program.stderr
    assert program.returncode == 0
    assert "Traceback" not in program.stderr
    assert len(list(tmp_path.iterdir())) == 2


def children(pid: int) -> list[int]:
    found = subprocess.run(["pgrep", "-P", str(pid)], capture_output=True, check=False)
    return list(map(int, found.stdout.split()))
