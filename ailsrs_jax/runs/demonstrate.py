"""Demonstrations made by rolling out an expert, and kept for the next run."""

import contextlib
import hashlib
import os
from pathlib import Path

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from ailsrs_jax.components.policy import LinearPolicy
from ailsrs_jax.data.demonstrations import Demonstrations, load_demonstrations, save_demonstrations
from ailsrs_jax.data.policies import SavedPolicy, expert_path, load_policy
from ailsrs_jax.envs.mujoco_task import MujocoTask
from ailsrs_jax.envs.registry import make_env
from ailsrs_jax.errors import UserError
from ailsrs_jax.trainers.rollout import Rollout, rollout

EPISODE_LENGTH = 1000  # Gymnasium's time limit for all of the tasks


def simulate(
    policy: SavedPolicy, env: MujocoTask, num_episodes: int, seed: int, episode_length: int
) -> Rollout:
    """Roll out ``policy`` in ``env``; episode ``i`` does not depend on how many there are."""
    policy.require_shape(env.action_size, env.observation_size)
    keys = jax.vmap(jax.random.fold_in, (None, 0))(jax.random.key(seed), jnp.arange(num_episodes))
    linear = LinearPolicy(
        *map(jnp.float32, (policy.weights, policy.mean, policy.std)),
        *map(jnp.float32, (policy.action_low, policy.action_high)),
    )
    policies = linear.with_weights(jnp.tile(linear.weights, (num_episodes, 1, 1)))
    simulated: Rollout = jax.jit(rollout, static_argnums=(0, 3))(
        env, policies, keys, episode_length
    )
    return simulated


def demonstrate(
    policy: SavedPolicy,
    num_trajectories: int,
    *,
    physics: str = "auto",
    seed: int = 0,
    episode_length: int = EPISODE_LENGTH,
) -> Demonstrations:
    """Roll out ``num_trajectories`` episodes of ``policy`` in its environment."""
    if num_trajectories < 1:
        raise UserError(f"{num_trajectories} trajectories asked for: at least one is needed")
    env = make_env(policy.env_id, physics)
    episodes = simulate(policy, env, num_trajectories, seed, episode_length)
    return Demonstrations(
        observations=np.asarray(episodes.observations).swapaxes(0, 1),
        actions=np.asarray(episodes.actions).swapaxes(0, 1),
        lengths=np.asarray(episodes.lengths),
        returns=np.asarray(episodes.env_returns),
        env_id=policy.env_id,
    )


def expert_demonstrations(env_id: str, num_trajectories: int, physics: str) -> Demonstrations:
    """Demonstrations of the expert that ships with the package, from the cache if they are there.

    The cache's key is a hash of all that they depend on. A cache that cannot be written or read is
    done without.
    """
    path = expert_path(env_id)
    engine = make_env(env_id, physics).backend
    content = f"{num_trajectories} {engine} {mujoco.__version__}".encode() + path.read_bytes()
    name = f"{env_id}-{hashlib.sha256(content).hexdigest()[:16]}.npz"
    cached = cache_directory() / "demonstrations" / name
    try:
        return load_demonstrations(cached)
    except UserError:
        demonstrations = demonstrate(load_policy(path), num_trajectories, physics=engine)
    with contextlib.suppress(UserError):
        save_demonstrations(demonstrations, cached)
    return demonstrations


def cache_directory() -> Path:
    """Where things are kept that can be made again."""
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base) / "ailsrs_jax"
