"""Demonstrations from rolling out an expert; those of the shipped experts are cached."""

import contextlib
import functools
import hashlib
import math
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np

from ailsrs_jax.components.policy import repeated
from ailsrs_jax.data.demonstrations import Demonstrations, load_demonstrations, save_demonstrations
from ailsrs_jax.data.episodes import Recording
from ailsrs_jax.data.policies import SavedPolicy, expert_path, load_policy
from ailsrs_jax.envs import Env
from ailsrs_jax.envs.interface import env_sizes
from ailsrs_jax.envs.physics import choose_engine
from ailsrs_jax.envs.registry import open_env
from ailsrs_jax.envs.wrappers import LateEnd
from ailsrs_jax.errors import UserError
from ailsrs_jax.files import cache_directory
from ailsrs_jax.runs.policies import jax_policy
from ailsrs_jax.runs.storage.config import installed_versions, require_seed
from ailsrs_jax.trainers.parts.episodes import Episodes
from ailsrs_jax.trainers.parts.rollout import simulate

NOISE_STREAM = 1  # of random numbers, distinct from those of a reset
EPISODE_LENGTH = 1000  # Gymnasium's time limit for all of the tasks


def roll_out(
    policy: SavedPolicy,
    env: Env,
    num_episodes: int,
    key: jax.Array,
    episode_length: int = EPISODE_LENGTH,
    noise_std: np.ndarray | float | None = None,
) -> Episodes:
    """Roll out ``policy`` in ``env``; episode ``i`` does not depend on the number of episodes.

    Args:
        policy: the policy.
        env: the environment.
        num_episodes: how many episodes.
        key: of the initial states and the noise.
        episode_length: the time limit in environment steps.
        noise_std: standard deviation, a number or ``(p,)``, of Gaussian noise that is added to the
            actions before they are clipped.

    Raises:
        UserError: the policy does not fit the environment.
    """
    n, p = env_sizes(env)
    policy.require_shape(p, n)
    keys = jax.vmap(jax.random.fold_in, (None, 0))(key, jnp.arange(num_episodes))
    policies = repeated(jax_policy(policy), num_episodes)
    noise = None
    if noise_std is not None:
        # Each episode has its own key, so that its noise does not depend on their number either.
        noise_keys = jax.vmap(jax.random.fold_in, (0, None))(keys, NOISE_STREAM)
        draws = [jax.random.normal(noise_key, (episode_length, p)) for noise_key in noise_keys]
        noise = noise_std * jnp.stack(draws)
    return _compiled_rollout(env, episode_length)(policies, keys, noise)


@functools.lru_cache(maxsize=4)
def _compiled_rollout(env: Env, episode_length: int) -> Callable[..., Episodes]:
    """Compile the simulation once for all policies of a run."""
    return jax.jit(
        lambda policies, keys, noise: simulate(env, policies, keys, episode_length, noise=noise)
    )


def demonstrate(
    policy: SavedPolicy,
    num_trajectories: int,
    *,
    env: Env | None = None,
    physics: str = "auto",
    seed: int = 0,
    episode_length: int = EPISODE_LENGTH,
    action_noise: float = 0.0,
) -> Demonstrations:
    """Roll out ``num_trajectories`` episodes of ``policy``.

    >>> import ailsrs_jax as ail
    >>> demonstrations = ail.demonstrate(ail.load_expert("swimmer"), 2, episode_length=100)
    >>> demonstrations.observations.shape
    (2, 100, 8)
    >>> ail.save_demonstrations(demonstrations, "swimmer.npz")
    >>> ail.load_demonstrations("swimmer.npz").num_trajectories
    2

    Args:
        policy: the expert.
        num_trajectories: how many episodes.
        env: any Brax environment; by default the task that the policy names.
        physics: ``auto``, ``mjx`` or ``mujoco``, for a task given by name.
        seed: of the initial states.
        episode_length: the time limit in environment steps.
        action_noise: standard deviation of Gaussian noise added to the actions, in their units. The
            demonstrations hold the actions with the noise.

    Raises:
        UserError: an argument is wrong, the policy does not fit, or an episode diverges.
    """
    recording = record(
        policy,
        num_trajectories,
        env=env,
        physics=physics,
        seed=seed,
        episode_length=episode_length,
        action_noise=action_noise,
    )
    return recording.demonstrations


def record(
    policy: SavedPolicy,
    num_trajectories: int,
    *,
    env: Env | None = None,
    physics: str = "auto",
    seed: int = 0,
    episode_length: int = EPISODE_LENGTH,
    action_noise: float = 0.0,
) -> Recording:
    """Do as :func:`demonstrate`; also return what :func:`save_minari` needs beside it."""
    if min(num_trajectories, episode_length) < 1:
        raise UserError(
            f"{num_trajectories} trajectories of {episode_length} steps asked for: ask for at "
            "least one"
        )
    if not (math.isfinite(action_noise) and action_noise >= 0):
        raise UserError(f"action_noise is {action_noise}: it must be 0 or more")
    require_seed(seed)
    task = open_env(policy.env_id if env is None else env, physics)
    key, noise_std = jax.random.key(seed), action_noise or None
    episodes = roll_out(
        policy, _late_end(task.env), num_trajectories, key, episode_length + 1, noise_std
    )
    if diverged := np.flatnonzero(episodes.diverged).tolist():
        raise UserError(
            f"episode {diverged[0]} of the expert diverged, and {len(diverged) - 1} more of "
            f"{num_trajectories}: the physics is unstable under this policy"
        )
    lengths = np.asarray(episodes.lengths) - 1
    observations, actions, env_rewards = map(
        np.asarray, (episodes.observations, episodes.actions, episodes.env_rewards)
    )
    alive = np.arange(episode_length) < lengths[:, None]
    demonstrations = Demonstrations(
        observations=np.where(alive[..., None], observations[:, :-1], 0.0),
        actions=np.where(alive[..., None], actions[:, :-1], 0.0),
        lengths=lengths,
        # In double precision, so that a reader who sums in another order gets the same number.
        returns=env_rewards[:, :-1].sum(axis=1, dtype=np.float64).astype(np.float32),
        env_id=task.env_id,
    )
    final_observations = observations[np.arange(num_trajectories), lengths]
    return Recording(demonstrations, env_rewards[:, :-1], final_observations)


_late_end = functools.lru_cache(maxsize=4)(LateEnd)  # to compile each environment once


def expert_demonstrations(
    env_id: str, num_trajectories: int, physics: str, *, of_paper: bool = False
) -> Demonstrations:
    """Return demonstrations of the expert that ships with the package, from the cache if possible.

    The file name in the cache is a hash of all that the demonstrations depend on. If the cache
    cannot be read or written, they are simulated again.

    Args:
        env_id: the task.
        num_trajectories: how many episodes.
        physics: ``auto``, ``mjx`` or ``mujoco``.
        of_paper: use the expert that returns what the paper's does, where there are two.
    """
    path = expert_path(env_id, of_paper=of_paper)
    engine, _ = choose_engine(physics)
    backend = jax.default_backend()
    content = f"{num_trajectories} {engine} {backend} {installed_versions()}".encode()
    name = f"{env_id}-{hashlib.sha256(content + path.read_bytes()).hexdigest()[:16]}.npz"
    cached = cache_directory() / "demonstrations" / name
    try:
        return load_demonstrations(cached)
    except UserError:
        demonstrations = demonstrate(load_policy(path), num_trajectories, physics=engine)
    with contextlib.suppress(UserError):
        save_demonstrations(demonstrations, cached)
    return demonstrations
