"""Whole episodes on the C engine, against Gymnasium's own environments and the stepped tasks."""

import gc
import itertools
import threading
import time
import weakref
from pathlib import Path
from typing import Any

import gymnasium
import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from ailsrs_jax.components.policy import LinearPolicy, MlpPolicy, repeated
from ailsrs_jax.data.policies import expert_path, load_policy
from ailsrs_jax.envs.interface import action_range
from ailsrs_jax.envs.physics import InitialState
from ailsrs_jax.envs.physics.quiet import without_warnings
from ailsrs_jax.envs.registry import TASKS, make_env
from ailsrs_jax.envs.tasks.mujoco_task import MujocoTask
from ailsrs_jax.envs.tasks.swimmer import Swimmer
from ailsrs_jax.host_calls import Interrupted, host_errors, interruptible
from ailsrs_jax.runs.policies import jax_policy
from ailsrs_jax.trainers.parts.episodes import Episodes
from ailsrs_jax.trainers.parts.rollout import simulate
from tests.exploding import StiffSlider

LENGTH = 300


def draw_starts(env: Any, num_episodes: int) -> InitialState:
    return jax.vmap(env.draw_start)(jax.random.split(jax.random.key(0), num_episodes))


def expert_episodes(env: Any, num_episodes: int, episode_length: int = LENGTH) -> Episodes:
    """Episodes of the expert, whose actions get some noise."""
    starts = draw_starts(env, num_episodes)
    policies = repeated(
        jax_policy(load_policy(expert_path(type(env).__name__ + "-v5"))), num_episodes
    )
    shape = (num_episodes, episode_length, env.action_size)
    noise = 0.2 * jax.random.normal(jax.random.key(1), shape)
    episodes: Episodes = jax.jit(
        lambda: simulate(env, policies, starts, episode_length, noise=noise)
    )()
    return episodes


def stepped_like(env: MujocoTask) -> Any:
    """The same task, which says that it must be stepped."""
    return type("Stepped", (type(env),), {"runs_episodes": False})("mujoco")


@pytest.mark.parametrize("limit", [LENGTH, pytest.param(1000, marks=pytest.mark.slow)])
@pytest.mark.parametrize("env_id", TASKS)
def test_they_are_gymnasiums_bit_for_bit(env_id: str, limit: int) -> None:
    env = make_env(env_id, "mujoco")
    assert env.runs_episodes
    episodes = expert_episodes(env, 2, limit)
    with without_warnings():
        theirs = gymnasium.make(env_id, max_episode_steps=limit).unwrapped
    starts = draw_starts(env, 2)
    for i in range(2):
        theirs.reset(seed=0)
        mujoco.mj_resetData(theirs.model, theirs.data)
        theirs.set_state(np.float64(starts.qpos[i]), np.float64(starts.qvel[i]))
        observation, length = theirs._get_obs(), int(episodes.lengths[i])
        for step in range(length):
            assert np.array_equal(episodes.observations[i, step], np.float32(observation)), step
            observation, reward, terminated, *_ = theirs.step(np.asarray(episodes.actions[i, step]))
            assert float(episodes.env_rewards[i, step]) == pytest.approx(reward, abs=5e-3)
            assert terminated == (step + 1 == length < limit)
        assert np.array_equal(episodes.final_observations[i], np.float32(observation))
        assert not episodes.observations[i, length:].any()
        assert not episodes.env_rewards[i, length:].any()


@pytest.mark.parametrize("num_threads", [1, 3])
def test_the_number_of_threads_does_not_matter(
    num_threads: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    expected = expert_episodes(make_env("hopper", "mujoco"), 7, 100)
    monkeypatch.setattr("ailsrs_jax.envs.tasks.mujoco_task.available_cores", lambda: num_threads)
    episodes = expert_episodes(make_env("hopper", "mujoco"), 7, 100)
    for mine, theirs in zip(jax.tree.leaves(episodes), jax.tree.leaves(expected), strict=True):
        np.testing.assert_array_equal(mine, theirs)


@pytest.mark.parametrize("env_id", ["Hopper-v5", "Ant-v5"])
def test_they_are_those_of_the_stepped_task(env_id: str) -> None:
    """Networks too; until the simulation has magnified what was rounded otherwise."""
    env = make_env(env_id, "mujoco")
    low, high = action_range(env)
    sizes = (env.observation_size, 5, env.action_size)
    keys = jax.random.split(jax.random.key(0), 4)
    policies = repeated(
        MlpPolicy(
            weights=tuple(
                jax.random.normal(keys[0], (outputs, inputs)) / inputs**0.5
                for inputs, outputs in itertools.pairwise(sizes)
            ),
            biases=(jnp.linspace(-1, 1, 5), jnp.full(env.action_size, 0.1)),
            mean=jnp.full(env.observation_size, 0.1),
            std=jnp.full(env.observation_size, 2.0),
            action_low=low,
            action_high=high,
            action_std=jnp.ones(env.action_size),
        ),
        4,
    )
    whole = jax.jit(lambda: simulate(env, policies, keys, 15))()
    stepped = jax.jit(lambda: simulate(stepped_like(env), policies, keys, 15))()
    for name in ("observations", "actions", "env_rewards", "lengths", "final_observations"):
        np.testing.assert_allclose(getattr(whole, name), getattr(stepped, name), atol=1e-3)


def test_they_begin_where_they_are_told_to() -> None:
    env = make_env("halfcheetah", "mujoco")
    starts = InitialState(
        qpos=jnp.linspace(-0.1, 0.1, 9) * jnp.ones((2, 1)),
        qvel=jnp.array([[0.0], [1.0]]) * jnp.ones(9),
    )
    still = LinearPolicy(jnp.zeros((6, 17)), jnp.zeros(17), jnp.ones(17), *action_range(env))
    whole = jax.jit(lambda: simulate(env, repeated(still, 2), starts, 5))()
    np.testing.assert_array_equal(whole.observations[:, 0, :8], starts.qpos[:, 1:])
    np.testing.assert_array_equal(whole.observations[:, 0, 8:], starts.qvel)


def test_what_explodes_ends_before(tmp_path: Path) -> None:
    env = StiffSlider("mujoco", tmp_path)
    keys = jax.random.split(jax.random.key(0), 20)
    still = LinearPolicy(jnp.zeros((1, 2)), jnp.zeros(2), jnp.ones(2), *action_range(env))
    episodes = jax.jit(lambda: simulate(env, repeated(still, 20), keys, 50))()
    diverged = np.asarray(episodes.diverged)
    assert 0 < diverged.sum() < 20
    for array in (episodes.observations, episodes.actions, episodes.final_observations):
        assert np.isfinite(array).all()
    assert np.array_equal(np.isnan(episodes.env_rewards).sum(axis=1), diverged)
    assert (np.asarray(episodes.lengths)[~diverged] == 50).all()


class Logarithm(Swimmer):
    """Rewards an angle, and none beyond a limit."""

    def _reward_terms(self, before: Any, after: Any, action: Any) -> dict[str, jax.Array]:
        return {"reward": jnp.log(0.11 - jnp.abs(after.qpos[2]))}


def test_a_reward_that_is_not_finite_is_divergence() -> None:
    env = Logarithm("mujoco")
    keys = jax.random.split(jax.random.key(0), 8)
    push = LinearPolicy(jnp.ones((2, 8)), jnp.zeros(8), jnp.ones(8), *action_range(env))
    episodes = jax.jit(lambda: simulate(env, repeated(push, 8), keys, 50))()
    stepped = jax.jit(lambda: simulate(stepped_like(env), repeated(push, 8), keys, 50))()
    assert stepped.diverged.any()
    for name in ("lengths", "diverged"):
        np.testing.assert_array_equal(getattr(episodes, name), getattr(stepped, name))
    np.testing.assert_allclose(episodes.env_rewards, stepped.env_rewards, atol=1e-3)


@pytest.mark.parametrize("whole", [True, False])
def test_nothing_is_left_of_an_environment(whole: bool) -> None:
    """Its threads used to keep it, one for each core and environment."""

    def played() -> weakref.ref[Any]:
        env: Any = TASKS["Ant-v5"]("mujoco")
        env = env if whole else stepped_like(env)
        still = LinearPolicy(jnp.zeros((8, 105)), jnp.zeros(105), jnp.ones(105), *action_range(env))
        keys = jax.random.split(jax.random.key(0), 2)
        jax.block_until_ready(jax.jit(lambda: simulate(env, repeated(still, 2), keys, 3))())
        return weakref.ref(env._episode_runner if whole else env.physics)

    left, threads = played(), threading.active_count()
    jax.clear_caches()
    gc.collect()
    assert left() is None
    deadline = time.monotonic() + 5
    while threading.active_count() >= threads:
        assert time.monotonic() < deadline
        time.sleep(0.05)


def test_it_ends_within_a_second_when_somebody_asks() -> None:
    env = make_env("humanoid", "mujoco")
    still = LinearPolicy(jnp.zeros((17, 348)), jnp.zeros(348), jnp.ones(348), *action_range(env))
    env = make_env("humanoid", "mujoco", terminate_when_unhealthy=False)
    keys = jax.random.split(jax.random.key(0), 40)
    run = jax.jit(lambda: simulate(env, repeated(still, 40), keys, 2_000)).lower().compile()
    started = time.perf_counter()
    with (
        interruptible(lambda: time.perf_counter() > started + 1),
        pytest.raises(Interrupted),
        host_errors(),
    ):
        jax.block_until_ready(run())
    assert time.perf_counter() < started + 3
