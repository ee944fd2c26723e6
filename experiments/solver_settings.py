"""Measure the error of MJX against the C engine after one environment step, by solver settings.

usage: python experiments/solver_settings.py [ENV ...]

The error of a state is the largest error among its joint velocities [m/s, rad/s]. The states are
those that random actions and random linear policies visit. For each setting, it prints the median,
the 99th percentile and the maximum of the error.
"""

import inspect
import sys

import jax
import jax.numpy as jnp
import numpy as np

from ailsrs_jax.envs.physics import PhysicsState, mjx_engine
from ailsrs_jax.envs.registry import TASKS, make_env, resolve_env_id

# (iterations, ls_iterations, tolerance); the last are MuJoCo's defaults.
SETTINGS = [(4, 4, 1e-4), (6, 4, 1e-4), (8, 6, 1e-4), (100, 50, 1e-8)]
NUM_EPISODES, NUM_STEPS = 64, 60


def visited(env_id: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return positions, velocities and actions under random actions and random policies."""
    fall_on = "terminate_when_unhealthy" in inspect.signature(TASKS[env_id]).parameters
    env = make_env(env_id, "mujoco", **({"terminate_when_unhealthy": False} if fall_on else {}))
    low, high = env.action_low, env.action_high

    def episode(key: jax.Array, is_linear: jax.Array) -> tuple[PhysicsState, jax.Array]:
        reset_key, weights_key, action_key = jax.random.split(key, 3)
        weights = 0.1 * jax.random.normal(weights_key, (env.action_size, env.observation_size))

        def step(state, key):
            linear = jnp.clip(high * (weights @ jnp.clip(state.obs, -5, 5)), low, high)
            action = jnp.where(
                is_linear, linear, jax.random.uniform(key, low.shape, None, low, high)
            )
            return env.step(state, action), (state.pipeline_state, action)

        keys = jax.random.split(action_key, NUM_STEPS)
        return jax.lax.scan(step, env.reset(reset_key), keys)[1]

    keys = jax.random.split(jax.random.key(0), NUM_EPISODES)
    states, actions = jax.jit(jax.vmap(episode))(keys, jnp.arange(NUM_EPISODES) % 2 == 0)
    every_third = (slice(None), slice(None, None, 3))
    arrays = (np.asarray(x)[every_third] for x in (states.qpos, states.qvel, actions))
    return tuple(x.reshape(-1, x.shape[-1]) for x in arrays)


def velocities_after(env_id: str, physics: str, arrays: tuple[np.ndarray, ...]) -> np.ndarray:
    """Return the joint velocities ``(B, nv)`` one environment step later."""
    engine = make_env(env_id, physics).physics

    def step(qpos: jax.Array, qvel: jax.Array, action: jax.Array) -> jax.Array:
        return engine.step(engine.init(qpos, qvel), action, jnp.array(True)).qvel

    return np.asarray(jax.jit(jax.vmap(step))(*arrays))


def main() -> None:
    """Print one line for each setting of each task."""
    for env_id in [resolve_env_id(name) for name in sys.argv[1:]] or TASKS:
        arrays = visited(env_id)
        expected = velocities_after(env_id, "mujoco", arrays)
        print(f"{env_id}, {len(expected)} states")
        for settings in SETTINGS:
            names = ("SOLVER_ITERATIONS", "LINE_SEARCH_ITERATIONS", "SOLVER_TOLERANCE")
            for name, value in zip(names, settings, strict=True):
                setattr(mjx_engine, name, value)
            errors = abs(velocities_after(env_id, "mjx", arrays) - expected).max(axis=1)
            median, high = np.quantile(errors, [0.5, 0.99])
            summary = f"median {median:.1e}, p99 {high:.1e}, most {errors.max():.1e}"
            print(f"  {settings}: {summary}", flush=True)


if __name__ == "__main__":
    main()
