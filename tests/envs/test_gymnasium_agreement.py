"""Every task on both engines against Gymnasium's own environment, one step at a time."""

from typing import Any, NamedTuple

import gymnasium
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ailsrs_jax.data.policies import expert_path, load_policy
from ailsrs_jax.envs.mujoco_task import MujocoTask, without_warnings
from ailsrs_jax.envs.physics import PhysicsState
from ailsrs_jax.envs.registry import TASKS, make_env

NON_DEFAULT_FLAGS: dict[str, dict[str, Any]] = {
    "HalfCheetah-v5": {
        "frame_skip": 3,
        "forward_reward_weight": 2.0,
        "ctrl_cost_weight": 0.5,
        "exclude_current_positions_from_observation": False,
    },
    "Hopper-v5": {
        "forward_reward_weight": 0.5,
        "healthy_reward": 3.0,
        "healthy_state_range": (-2.0, 2.0),
        "healthy_z_range": (0.9, 1.3),
        "exclude_current_positions_from_observation": False,
    },
    "Swimmer-v5": {
        "ctrl_cost_weight": 0.3,
        "exclude_current_positions_from_observation": False,
    },
    "Walker2d-v5": {
        "healthy_reward": 0.1,
        "terminate_when_unhealthy": False,
        "healthy_angle_range": (-0.1, 0.1),
        "frame_skip": 2,
    },
}


class Steps(NamedTuple):
    """What Gymnasium did, one row per step."""

    qpos: np.ndarray
    qvel: np.ndarray
    action: np.ndarray
    next_observation: np.ndarray
    reward: np.ndarray
    terms: dict[str, np.ndarray]
    terminated: np.ndarray


def gymnasium_steps(env_id: str, num_steps: int, **flags: Any) -> Steps:
    """Steps from states that random actions, and where it fits the expert, visit."""
    with without_warnings():
        env = gymnasium.make(env_id, **flags).unwrapped
    expert = load_policy(expert_path(env_id))
    observation, _ = env.reset(seed=0)
    rng, rows = np.random.default_rng(0), []
    for time in range(num_steps):
        action = np.float32(rng.uniform(-1.2, 1.2, env.action_space.shape))
        if time % 400 >= 100 and expert.weights.shape[1] == len(observation):
            action = np.float32(expert(observation) + 0.1 * action)
        qpos, qvel = env.data.qpos.copy(), env.data.qvel.copy()
        observation, reward, terminated, _, info = env.step(action)
        terms = {name: value for name, value in info.items() if name.startswith("reward_")}
        rows.append((qpos, qvel, action, observation, reward, terms, terminated))
        if terminated or time % 400 == 99:
            observation, _ = env.reset(seed=time)
    *arrays, terms, terminated = zip(*rows, strict=True)
    return Steps(
        *map(np.array, arrays),
        {name: np.array([row[name] for row in terms]) for name in terms[0]},
        np.array(terminated),
    )


def our_steps(env: MujocoTask, steps: Steps) -> tuple[Any, Any]:
    """The same steps by our task, all at once, each from Gymnasium's state."""

    def step(qpos: jax.Array, qvel: jax.Array, action: jax.Array) -> tuple[Any, Any]:
        state = env.reset(jax.random.key(0))
        state = state.replace(pipeline_state=env.physics.init(qpos, qvel))
        state = env.step(state, action)
        return state.replace(pipeline_state=None), state.pipeline_state

    arrays = map(jnp.float32, (steps.qpos, steps.qvel, steps.action))
    return jax.jit(jax.vmap(step))(*arrays)


def assert_agree(env: MujocoTask, steps: Steps, tolerance: float) -> None:
    state, _ = our_steps(env, steps)
    assert state.obs.shape == steps.next_observation.shape
    # Velocities reach tens of rad/s, so the error is relative to the larger of 1 and the value.
    scale = np.maximum(1.0, np.abs(steps.next_observation))
    errors = np.abs(state.obs - steps.next_observation) / scale
    assert np.quantile(errors.max(axis=1), 0.99) < tolerance
    assert np.median(errors) < tolerance / 20
    reward_errors = np.abs(state.reward - steps.reward) / np.maximum(1.0, np.abs(steps.reward))
    assert np.quantile(reward_errors, 0.99) < 10 * tolerance
    for name, values in steps.terms.items():
        term_errors = np.abs(state.metrics[name] - values) / np.maximum(1.0, np.abs(values))
        assert np.quantile(term_errors, 0.99) < 10 * tolerance, name
    # A state on the very border may fall on either side; a step that ends is one in a hundred.
    disagreements = np.sum(np.asarray(state.done, bool) != steps.terminated)
    assert disagreements <= 0.05 * steps.terminated.sum()


@pytest.mark.parametrize("env_id", TASKS)
@pytest.mark.parametrize(("physics", "tolerance"), [("mujoco", 1e-4), ("mjx", 2e-3)])
def test_one_step_from_gymnasiums_states(env_id: str, physics: str, tolerance: float) -> None:
    steps = gymnasium_steps(env_id, 1200)
    if TASKS[env_id].__name__ in ("Hopper", "Walker2d"):
        assert steps.terminated.any()
    assert_agree(make_env(env_id, physics), steps, tolerance)


@pytest.mark.parametrize("env_id", TASKS)
def test_constructor_flags(env_id: str) -> None:
    flags = NON_DEFAULT_FLAGS[env_id]
    steps = gymnasium_steps(env_id, 300, **flags)
    assert_agree(make_env(env_id, "mujoco", **flags), steps, 1e-4)


@pytest.mark.parametrize("env_id", TASKS)
def test_whole_trajectory_of_the_c_engine(env_id: str) -> None:
    """Nothing is rounded between steps, so 100 steps in a row stay together."""
    env = make_env(env_id, "mujoco")
    with without_warnings():
        reference = gymnasium.make(env_id).unwrapped
    reference.reset(seed=0)
    state = jax.jit(env.reset)(jax.random.key(0))
    physics_state = state.pipeline_state
    reference.set_state(*map(np.float64, (physics_state.qpos, physics_state.qvel)))
    step = jax.jit(env.step)
    rng = np.random.default_rng(0)
    for _ in range(100):
        action = np.float32(rng.uniform(-0.3, 0.3, env.action_size))
        state = step(state, action)
        observation, reward, terminated, _, _ = reference.step(action)
        np.testing.assert_allclose(state.obs, observation, rtol=1e-3, atol=1e-3)
        np.testing.assert_allclose(state.reward, reward, rtol=1e-2, atol=1e-2)
        assert bool(state.done) == terminated
        if terminated:
            break


@pytest.mark.parametrize("env_id", TASKS)
def test_reset_noise_is_gymnasiums(env_id: str) -> None:
    """Mean, spread and range of 2000 initial states against 300 of Gymnasium's."""
    env = make_env(env_id, "mujoco")
    keys = jax.random.split(jax.random.key(0), 2000)
    ours = np.asarray(jax.jit(jax.vmap(env.reset))(keys).obs)
    with without_warnings():
        reference = gymnasium.make(env_id).unwrapped
    theirs = np.array([reference.reset(seed=seed)[0] for seed in range(300)])
    spread = theirs.std(axis=0)
    np.testing.assert_allclose(ours.mean(axis=0), theirs.mean(axis=0), atol=0.3 * spread.max())
    np.testing.assert_allclose(ours.std(axis=0), spread, rtol=0.25)
    assert (np.ptp(ours, axis=0) < 3 * np.ptp(theirs, axis=0)).all()


def test_a_finished_simulation_is_left_alone() -> None:
    env = make_env("hopper", "mujoco")
    state = jax.vmap(env.reset)(jax.random.split(jax.random.key(0), 3))
    state = state.replace(done=jnp.array([0.0, 1.0, 0.0]))
    after = jax.vmap(env.step)(state, jnp.ones((3, 3))).pipeline_state
    moved = np.any(after.qpos != state.pipeline_state.qpos, axis=1)
    assert moved.tolist() == [True, False, True]
    assert isinstance(after, PhysicsState)
