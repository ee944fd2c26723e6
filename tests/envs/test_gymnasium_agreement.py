"""Agreement of every task, on both engines, with Gymnasium's own environment, step by step."""

import functools
import inspect
import itertools
from typing import Any, NamedTuple

import gymnasium
import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from gymnasium.envs.registration import load_env_creator

from ailsrs_jax.data.policies import expert_path, load_policy
from ailsrs_jax.envs.physics import PhysicsState
from ailsrs_jax.envs.physics.quiet import without_warnings
from ailsrs_jax.envs.registry import TASKS, make_env
from ailsrs_jax.envs.tasks.mujoco_task import MujocoTask

TOLERANCES = {"mujoco": 1e-5, "mjx": 2e-3}
# Errors of the velocities after a step [m/s, rad/s]: the median, and the 99th percentile of the
# largest error of a step. Humanoid's own solver (PGS) is less precise.
MAX_VELOCITY_ERRORS = dict.fromkeys(TASKS, (1e-5, 5e-4)) | {"Humanoid-v5": (5e-5, 1e-3)}

NON_DEFAULT_FLAGS: dict[str, dict[str, Any]] = {
    "Ant-v5": {
        "frame_skip": 4,
        "forward_reward_weight": 0.5,
        "ctrl_cost_weight": 0.1,
        "contact_cost_weight": 0.01,
        "healthy_reward": 2.0,
        "main_body": "aux_1",
        "healthy_z_range": (0.4, 0.9),
        "contact_force_range": (-5.0, 20.0),
        "reset_noise_scale": 0.05,
        "exclude_current_positions_from_observation": False,
    },
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
    "Humanoid-v5": {
        "frame_skip": 3,
        "forward_reward_weight": 0.5,
        "ctrl_cost_weight": 0.3,
        "contact_cost_weight": 1e-6,
        "contact_cost_range": (0.001, 0.05),
        "healthy_reward": 2.0,
        "terminate_when_unhealthy": False,
        "healthy_z_range": (1.3, 1.5),
        "reset_noise_scale": 0.05,
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
    """Steps of Gymnasium's environment, one row for each."""

    qpos: np.ndarray
    qvel: np.ndarray
    action: np.ndarray
    next_qvel: np.ndarray
    next_observation: np.ndarray
    reward: np.ndarray
    info: dict[str, np.ndarray]
    terminated: np.ndarray


def gymnasium_env(env_id: str, **flags: Any) -> Any:
    with without_warnings():
        return gymnasium.make(env_id, **flags).unwrapped


def set_state(env: Any, qpos: Any, qvel: Any) -> None:
    """Do what Gymnasium's reset does, with a given state."""
    mujoco.mj_resetData(env.model, env.data)
    env.set_state(np.float64(qpos), np.float64(qvel))


@functools.cache
def default_steps(env_id: str) -> Steps:
    """Steps with the default flags, which both engines are compared with."""
    return gymnasium_steps(env_id, 1200)


def gymnasium_steps(env_id: str, num_steps: int, **flags: Any) -> Steps:
    """Steps from states that random actions visit and, if its observations fit, the expert."""
    env = gymnasium_env(env_id, **flags)
    expert = load_policy(expert_path(env_id))
    observation, _ = env.reset(seed=0)
    rng, rows = np.random.default_rng(0), []
    for time in range(num_steps):
        action = np.float32(rng.uniform(-1.2, 1.2, env.action_space.shape))
        if time % 400 >= 100 and len(expert.mean) == len(observation):
            action = np.float32(expert(observation) + 0.1 * action)
        qpos, qvel = np.float32(env.data.qpos), np.float32(env.data.qvel)
        set_state(env, qpos, qvel)  # otherwise body positions and forces are outdated
        observation, reward, terminated, _, info = env.step(action)
        next_qvel = env.data.qvel.copy()
        rows.append((qpos, qvel, action, next_qvel, observation, reward, info, terminated))
        if terminated or time % 400 == 99:
            observation, _ = env.reset(seed=time)
    *arrays, infos, terminated = zip(*rows, strict=True)
    return Steps(
        *map(np.array, arrays),
        {name: np.array([info[name] for info in infos]) for name in infos[0]},
        np.array(terminated),
    )


def our_steps(env: MujocoTask, steps: Steps) -> tuple[Any, Any]:
    """The same steps by our task in one batch, each from Gymnasium's state."""

    def step(qpos: jax.Array, qvel: jax.Array, action: jax.Array) -> tuple[Any, Any]:
        state = env.reset(jax.random.key(0))
        state = state.replace(pipeline_state=env.physics.init(qpos, qvel))
        state = env.step(state, action)
        return state.replace(pipeline_state=None), state.pipeline_state

    arrays = map(jnp.float32, (steps.qpos, steps.qvel, steps.action))
    return jax.jit(jax.vmap(step))(*arrays)


def assert_agree(env: MujocoTask, steps: Steps, tolerance: float) -> np.ndarray:
    """Check everything that a step returns, and return the errors of the velocities."""
    state, physics_state = our_steps(env, steps)
    assert state.obs.shape == steps.next_observation.shape
    assert state.obs.shape[1] == env.observation_size
    # Velocities reach tens of rad/s, so the error is relative to the larger of 1 and the value.
    scale = np.maximum(1.0, np.abs(steps.next_observation))
    errors = np.abs(state.obs - steps.next_observation) / scale
    assert np.quantile(errors.max(axis=1), 0.99) < tolerance
    assert np.median(errors) < tolerance / 20
    reward_errors = np.abs(state.reward - steps.reward) / np.maximum(1.0, np.abs(steps.reward))
    assert np.quantile(reward_errors, 0.99) < 10 * tolerance
    assert {name for name in steps.info if name.startswith("reward_")} <= set(state.metrics)
    for name, ours in state.metrics.items():
        values = steps.info[name]
        term_errors = np.abs(ours - values) / np.maximum(1.0, np.abs(values))
        assert np.quantile(term_errors, 0.99) < 10 * tolerance, name
    # A state on the border of the healthy range may be judged either way.
    disagreements = np.sum(np.asarray(state.done, bool) != steps.terminated)
    assert disagreements <= 0.05 * steps.terminated.sum()
    return np.abs(physics_state.qvel - steps.next_qvel)


# These take long to compile on MJX.
SLOW = [(env_id, "mjx") for env_id in TASKS if env_id != "HalfCheetah-v5"]
EVERYWHERE = pytest.mark.parametrize(
    ("env_id", "physics"),
    [
        pytest.param(*case, marks=pytest.mark.slow if case in SLOW else ())
        for case in itertools.product(TASKS, ("mjx", "mujoco"))
    ],
)


@EVERYWHERE
def test_one_step_from_gymnasiums_states(env_id: str, physics: str) -> None:
    steps = default_steps(env_id)
    if env_id not in ("HalfCheetah-v5", "Swimmer-v5"):
        assert steps.terminated.any()
    if env_id in ("Ant-v5", "Humanoid-v5"):
        assert (steps.info["reward_contact"] < 0).mean() > 0.1
    velocity_errors = assert_agree(make_env(env_id, physics), steps, TOLERANCES[physics])
    median, percentile = MAX_VELOCITY_ERRORS[env_id]
    assert np.median(velocity_errors) < median
    assert np.quantile(velocity_errors.max(axis=1), 0.99) < percentile


@pytest.mark.parametrize("env_id", TASKS)
def test_names_and_defaults_of_flags(env_id: str) -> None:
    creator: Any = load_env_creator(gymnasium.spec(env_id).entry_point)
    ours, theirs = (
        {name: each.default for name, each in inspect.signature(function).parameters.items()}
        for function in (TASKS[env_id], creator)
    )
    assert ours.pop("physics") == "auto"
    assert theirs == ours | {name: theirs[name] for name in ("default_camera_config", "kwargs")}


@pytest.mark.parametrize("env_id", TASKS)
def test_constructor_flags(env_id: str) -> None:
    flags = NON_DEFAULT_FLAGS[env_id]
    steps = gymnasium_steps(env_id, 300, **flags)
    assert_agree(make_env(env_id, "mujoco", **flags), steps, TOLERANCES["mujoco"])


@pytest.mark.parametrize("env_id", TASKS)
def test_whole_trajectory_of_the_c_engine(env_id: str) -> None:
    """Nothing is rounded between steps, so 100 consecutive steps agree."""
    flags = {"terminate_when_unhealthy": False} if env_id == "Humanoid-v5" else {}
    env, reference = make_env(env_id, "mujoco", **flags), gymnasium_env(env_id, **flags)
    reference.reset(seed=0)
    state = jax.jit(env.reset)(jax.random.key(0))
    set_state(reference, state.pipeline_state.qpos, state.pipeline_state.qvel)
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
    if env.physics.readings:  # with the solver's warm start, every bit agrees
        bits = np.asarray(state.pipeline_state.carry).view(np.float64)
        qpos, qvel = reference.data.qpos, reference.data.qvel
        np.testing.assert_array_equal(bits[1 : 1 + qpos.size + qvel.size], [*qpos, *qvel])


@EVERYWHERE
def test_initial_observation(env_id: str, physics: str) -> None:
    env, reference = make_env(env_id, physics), gymnasium_env(env_id)
    state = jax.jit(env.reset)(jax.random.key(1))
    reference.reset(seed=0)
    set_state(reference, state.pipeline_state.qpos, state.pipeline_state.qvel)
    np.testing.assert_allclose(state.obs, reference._get_obs(), rtol=1e-5, atol=1e-6)
    for name, value in reference._get_reset_info().items():
        if name in state.metrics:
            np.testing.assert_allclose(state.metrics[name], value, rtol=1e-6)


@pytest.mark.parametrize(
    ("env_id", "name"),
    [
        ("Ant-v5", "cfrc_ext"),
        ("Humanoid-v5", "cinert"),
        ("Humanoid-v5", "cvel"),
        ("Humanoid-v5", "qfrc_actuator"),
        ("Humanoid-v5", "cfrc_ext"),
    ],
)
def test_each_part_of_the_observation_can_be_left_out(env_id: str, name: str) -> None:
    flags = {f"include_{name}_in_observation": False}
    env, reference = make_env(env_id, "mujoco", **flags), gymnasium_env(env_id, **flags)
    start = jax.jit(env.reset)(jax.random.key(0))
    reference.reset(seed=0)
    set_state(reference, start.pipeline_state.qpos, start.pipeline_state.qvel)
    action = np.full(env.action_size, 0.3, np.float32)
    state = jax.jit(env.step)(start, action)
    expected, *_ = reference.step(action)
    assert env.observation_size == expected.size
    np.testing.assert_allclose(state.obs, expected, rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("env_id", TASKS)
def test_reset_noise_is_gymnasiums(env_id: str) -> None:
    """Compare mean, spread and range of 2000 initial states with 300 of Gymnasium's."""
    env = make_env(env_id, "mujoco")
    keys = jax.random.split(jax.random.key(0), 2000)
    states = jax.jit(jax.vmap(env.reset))(keys).pipeline_state
    ours = np.concatenate([states.qpos, states.qvel], axis=1)
    reference, rows = gymnasium_env(env_id), []
    for seed in range(300):
        reference.reset(seed=seed)
        rows.append(reference.state_vector())
    theirs = np.array(rows)
    spread = theirs.std(axis=0)
    np.testing.assert_allclose(ours.mean(axis=0), theirs.mean(axis=0), atol=0.3 * spread.max())
    np.testing.assert_allclose(ours.std(axis=0), spread, rtol=0.25)
    assert (np.ptp(ours, axis=0) < 3 * np.ptp(theirs, axis=0)).all()


@pytest.mark.parametrize("env_id", ["Hopper-v5", "Ant-v5"])  # uniform and normal velocities
def test_reset_noise_has_the_given_scale(env_id: str) -> None:
    """The same keys give the same noise, scaled."""
    keys = jax.random.split(jax.random.key(0), 10)
    states = []
    for scale in (0.0, 0.01, 0.02):
        env = make_env(env_id, "mujoco", reset_noise_scale=scale)
        state = jax.jit(jax.vmap(env.reset))(keys).pipeline_state
        states.append(np.concatenate([state.qpos, state.qvel], axis=1))
    still, once, twice = states
    assert np.abs(once - still).max() > 0.005
    np.testing.assert_allclose(twice - still, 2 * (once - still), atol=1e-6)


@pytest.mark.parametrize("name", ["hopper", "ant"])
def test_a_finished_simulation_is_not_stepped(name: str) -> None:
    env = make_env(name, "mujoco")
    state = jax.jit(jax.vmap(env.reset))(jax.random.split(jax.random.key(0), 3))
    state = state.replace(done=jnp.array([0.0, 1.0, 0.0]))
    after = jax.jit(jax.vmap(env.step))(state, jnp.ones((3, env.action_size))).pipeline_state
    assert isinstance(after, PhysicsState)
    before = state.pipeline_state
    names = [name for name in before.readings if name != "cfrc_ext"]  # zero until something touches
    readings = [(before.readings[name], after.readings[name]) for name in names]
    for old, new in [(before.qpos, after.qpos), *readings]:
        moved = np.any(old != new, axis=tuple(range(1, old.ndim)))
        assert moved.tolist() == [True, False, True]
