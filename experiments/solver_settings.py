"""How far MJX is from the C engine after one environment step, by settings of its solver.

usage: python experiments/solver_settings.py [ENV ...]

Prints the largest error among the joint velocities [m/s, rad/s], over states that random actions
and random linear policies visit: its median, 99th percentile and maximum.
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
    """Positions, velocities and actions of random actions and of random linear policies."""
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
    """Joint velocities one environment step later, ``(B, nv)``."""
    engine = make_env(env_id, physics).physics

    def step(qpos: jax.Array, qvel: jax.Array, action: jax.Array) -> jax.Array:
        return engine.step(engine.init(qpos, qvel), action, jnp.array(True)).qvel

    return np.asarray(jax.jit(jax.vmap(step))(*arrays))


def main() -> None:
    """Print a line per setting of each task."""
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
