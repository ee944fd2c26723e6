from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from brax.envs.wrappers.training import EpisodeWrapper

from ailsrs_jax.components.policy import MlpPolicy, repeated
from ailsrs_jax.envs.gymnasium_env import GymnasiumEnv
from ailsrs_jax.envs.interface import action_range
from ailsrs_jax.envs.registry import make_env
from ailsrs_jax.envs.tasks.mujoco_task import MujocoTask
from ailsrs_jax.trainers.parts import segments
from ailsrs_jax.trainers.parts.rollout import simulate
from tests.envs.physics.test_episode_runner import Logarithm, stepped_like
from tests.point_mass import PointMass
from tests.workers import environments

INTEGRATOR = """
<mujoco>
  <option timestep="0.01" gravity="0 0 0"/>
  <worldbody><body><joint name="slide" type="slide"/><geom size="0.1" mass="1"/></body></worldbody>
  <actuator><general joint="slide" dyntype="integrator" ctrlrange="-1 1"/></actuator>
</mujoco>
"""


class Rewardless(MujocoTask):
    def _reward_terms(self, before, after, action):
        return {"reward": jnp.zeros(())}


def some_policy(push: float, action_std: float) -> MlpPolicy:
    """Always the same mean."""
    return MlpPolicy(
        weights=(jnp.zeros((4, 2)), jnp.zeros((1, 4))),
        biases=(jnp.zeros(4), jnp.array([push])),
        mean=jnp.zeros(2),
        std=jnp.ones(2),
        action_low=-jnp.ones(1),
        action_high=jnp.ones(1),
        action_std=jnp.array([action_std]),
    )


@pytest.mark.parametrize("push", [0.0, 1.0])  # the second leaves the range within 25 steps
def test_episodes_follow_one_another(push: float, point_mass: PointMass) -> None:
    limit = 30
    episodes = segments.begin(point_mass, jax.random.key(0), 3, limit)
    pieces = []
    for key in jax.random.split(jax.random.key(1), 2):
        policy = some_policy(push, 0.1)
        episodes, steps = segments.collect(point_mass, policy, episodes, key, 40, limit)
        pieces.append(steps)
    steps = jax.tree.map(lambda *x: jnp.concatenate(x), *pieces)

    over, following = np.asarray(steps.over), np.asarray(steps.next_observations)
    # Within an episode, over the batches' border too, states follow one another,
    same = ~over[:-1]
    np.testing.assert_array_equal(following[:-1][same], steps.observations[1:][same])
    # a new one begins where Brax's reset puts it,
    assert (np.abs(np.asarray(steps.observations[1:])[over[:-1]]) <= 1.0).all()
    # and none is longer than the limit.
    for env in range(3):
        ends = np.flatnonzero(over[:, env])
        lengths = np.diff(ends, prepend=-1)
        assert (lengths <= limit).all()
        outside = np.abs(following[ends, env, 0]) > 3
        np.testing.assert_array_equal(np.asarray(steps.terminated)[ends, env], outside)
        np.testing.assert_array_equal(lengths[~outside], limit)
    np.testing.assert_array_equal(np.clip(steps.drawn_actions, -1, 1), steps.actions)
    np.testing.assert_allclose(steps.env_rewards, -np.square(following[..., 0]), rtol=1e-5)


def test_the_limit_of_a_wrapper_is_no_terminal_state(point_mass: PointMass) -> None:
    env = EpisodeWrapper(point_mass, 5, 1)
    episodes = segments.begin(env, jax.random.key(0), 2, 30)
    _, steps = segments.collect(env, some_policy(0.0, 0.1), episodes, jax.random.key(1), 20, 30)
    np.testing.assert_array_equal(np.flatnonzero(steps.over[:, 0]) % 5, 4)
    assert not steps.terminated.any()


def test_actions_are_drawn_from_the_gaussian(point_mass: PointMass) -> None:
    episodes = segments.begin(point_mass, jax.random.key(0), 50, 1000)
    policy = some_policy(0.3, 0.2)
    _, steps = segments.collect(point_mass, policy, episodes, jax.random.key(1), 100, 1000)
    np.testing.assert_allclose(steps.drawn_actions.mean(), 0.3, atol=0.01)
    np.testing.assert_allclose(steps.drawn_actions.std(), 0.2, atol=0.01)


def policy_of(env: Any) -> MlpPolicy:
    """Keeps pushing, so that episodes end."""
    n, p = env.observation_size, env.action_size
    low, high = action_range(env)
    return MlpPolicy(
        weights=(jnp.full((4, n), 0.1), jnp.full((p, 4), 0.1)),
        biases=(jnp.zeros(4), jnp.linspace(0.5, -0.5, p)),
        mean=jnp.zeros(n),
        std=jnp.ones(n),
        action_low=low,
        action_high=high,
        action_std=jnp.full(p, 0.5),
    )


def two_batches(env: Any, num_steps: int, limit: int, again: Any = None) -> segments.Steps:
    """The second one in the environment ``again``."""
    episodes = segments.begin(env, jax.random.key(0), 3, limit)
    pieces = []
    for seed, place in enumerate((env, again or env)):
        program = jax.jit(
            lambda episodes, key, place=place: segments.collect(
                place, policy_of(env), episodes, key, num_steps, limit
            )
        )
        episodes, steps = program(episodes, jax.random.key(seed))
        pieces.append(steps)
    return jax.tree.map(lambda *x: np.concatenate(x), *pieces)


def assert_same(mine: segments.Steps, theirs: segments.Steps) -> None:
    for one, other in zip(jax.tree.leaves(mine), jax.tree.leaves(theirs), strict=True):
        np.testing.assert_array_equal(one, other)


def test_the_c_engine_goes_on_by_itself_as_it_is_stepped(monkeypatch: pytest.MonkeyPatch) -> None:
    """Until the simulation has magnified what was rounded otherwise."""
    env = make_env("hopper", "mujoco")
    steps = two_batches(env, 12, 8)
    stepped = two_batches(stepped_like(env), 12, 8)
    for mine, theirs in zip(jax.tree.leaves(steps), jax.tree.leaves(stepped), strict=True):
        np.testing.assert_allclose(mine, theirs, atol=1e-3)
    monkeypatch.setattr("ailsrs_jax.envs.tasks.mujoco_task.available_cores", lambda: 1)
    assert_same(two_batches(make_env("hopper", "mujoco"), 12, 8), steps)


@pytest.mark.parametrize("name", ["hopper", "Mass"])
def test_long_batches_follow_one_another(name: str) -> None:
    """What the first environment has simulated, another goes on with, to the same bits."""
    limit = 70
    envs = [
        GymnasiumEnv(environments.Mass, workers=number)
        if name == "Mass"
        else make_env(name, "mujoco")
        for number in (1, 2)
    ]
    steps = two_batches(envs[0], 50, limit)
    assert_same(two_batches(envs[1], 50, limit, again=envs[0]), steps)
    over = steps.over
    np.testing.assert_array_equal(
        steps.next_observations[:-1][~over[:-1]], steps.observations[1:][~over[:-1]]
    )
    lengths = np.diff(np.flatnonzero(over[:, 0]), prepend=-1)
    assert (lengths <= limit).all()
    assert steps.terminated.any()
    assert not steps.diverged.any()
    np.testing.assert_array_equal(steps.terminated & ~over, False)


def test_an_episode_with_a_reward_that_is_not_finite_is_left_out() -> None:
    env, limit = Logarithm("mujoco"), 3
    episodes = segments.begin(env, jax.random.key(0), 8, limit)
    _, steps = segments.collect(env, policy_of(env), episodes, jax.random.key(1), 7, limit)
    assert np.isfinite(steps.env_rewards).all()
    assert 0 < int(steps.diverged.sum()) < 24
    ends = np.flatnonzero(np.asarray(steps.diverged).any(axis=1))
    assert set(ends) <= {2, 5, 6}  # no episode ends before its time


def test_states_of_actuators_are_kept_between_batches(tmp_path: Path) -> None:
    """The force of this actuator is the integral of the actions."""
    path = tmp_path / "integrator.xml"
    path.write_text(INTEGRATOR)
    env = Rewardless(
        physics="mujoco",
        xml_file=str(path),
        frame_skip=1,
        reset_noise_scale=0.0,
        num_hidden_positions=0,
    )
    policy = some_policy(1.0, 0.0)
    episodes = segments.begin(env, jax.random.key(0), 1, 100)
    for key in jax.random.split(jax.random.key(1), 2):
        episodes, steps = segments.collect(env, policy, episodes, key, 20, 100)
    start = jax.random.split(jax.random.key(0), 1)
    whole = simulate(env, repeated(policy, 1), start, 40)
    last = steps.observations[-1, 0]
    assert float(last[1]) > 0.05
    np.testing.assert_allclose(last, whole.observations[0, -1], rtol=1e-4)


@pytest.mark.slow
def test_seeds_beside_one_another_are_those_alone() -> None:
    """On the C engine, whose environments of several seeds share a call."""
    env = make_env("hopper", "mujoco")

    def run(seed: jax.Array) -> segments.Steps:
        reset_key, key = jax.random.split(jax.random.key(seed))
        episodes = segments.begin(env, reset_key, 2, 1000)
        return segments.collect(env, policy_of(env), episodes, key, 40, 1000)[1]

    together = jax.jit(jax.vmap(run))(jnp.arange(2))
    assert together.over.any()
    for seed in range(2):
        alone = jax.jit(run)(seed)
        jax.tree.map(
            lambda many, one, seed=seed: np.testing.assert_array_equal(many[seed], one),
            together,
            alone,
        )


def test_nothing_is_reset_while_no_episode_is_over() -> None:
    """Beside other seeds too, where each branch of a condition would be computed."""
    resets = []

    class Counting(PointMass):
        def reset(self, rng):
            jax.debug.callback(lambda: resets.append(1))
            return super().reset(rng)

    env = Counting()

    def run(seed: jax.Array) -> segments.Steps:
        key = jax.random.key(seed)
        return segments.collect(
            env, some_policy(0.0, 0.0), segments.begin(env, key, 3, 10), key, 25, 10
        )[1]

    steps = jax.jit(jax.vmap(run))(jnp.arange(2))
    jax.block_until_ready(steps)
    jax.effects_barrier()
    assert np.flatnonzero(np.asarray(steps.over).any(axis=(0, 2))).tolist() == [9, 19]
    assert len(resets) == 3  # of all environments: at first, and after each end
