"""Demonstrations from rolling out an expert; those of the shipped experts are cached."""

import contextlib
import functools
import hashlib
import math
import operator
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ailsrs_jax.components.policy import repeated
from ailsrs_jax.data.demonstrations import Demonstrations, load_demonstrations, save_demonstrations
from ailsrs_jax.data.episodes import Recording
from ailsrs_jax.data.policies import SavedPolicy, expert_path, load_policy
from ailsrs_jax.envs import Env
from ailsrs_jax.envs.gymnasium_env import PREFIX, GymnasiumEnv
from ailsrs_jax.envs.interface import env_sizes
from ailsrs_jax.envs.physics import choose_engine
from ailsrs_jax.envs.registry import open_env, require_harmless
from ailsrs_jax.errors import UserError, refusing
from ailsrs_jax.files import cache_directory
from ailsrs_jax.host_calls import host_errors
from ailsrs_jax.runs.horizon import EPISODE_LENGTH, env_horizon
from ailsrs_jax.runs.policies import jax_policy
from ailsrs_jax.runs.storage.config import installed_versions, require_seed
from ailsrs_jax.trainers.parts.episodes import Episodes
from ailsrs_jax.trainers.parts.rollout import Starts, simulate

PythonPolicy = str | Callable[[np.ndarray], Any]

NOISE_STREAM = 1  # of random numbers, distinct from those of a reset


def roll_out(
    policy: SavedPolicy,
    env: Env,
    num_episodes: int,
    key: jax.Array,
    episode_length: int = EPISODE_LENGTH,
    noise_std: np.ndarray | float | None = None,
    starts: Starts | None = None,
) -> Episodes:
    """Roll out ``policy`` in ``env``; episode ``i`` does not depend on the number of episodes.

    ``key`` gives the noise and, without ``starts``, the initial states. ``noise_std``, a number or
    ``(p,)``, is the standard deviation of Gaussian noise that is added to the actions before they
    are clipped.

    Raises:
        UserError: the policy does not fit the environment, or the environment fails.
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
    with host_errors():
        run = _compiled_rollout(env, episode_length)
        return jax.block_until_ready(run(policies, keys if starts is None else starts, noise))


@functools.lru_cache(maxsize=4)
def _compiled_rollout(env: Env, episode_length: int) -> Callable[..., Episodes]:
    """Compile the simulation once for all policies of a run."""
    return jax.jit(
        lambda policies, starts, noise: simulate(env, policies, starts, episode_length, noise=noise)
    )


def demonstrate(
    policy: SavedPolicy | PythonPolicy,
    num_trajectories: int,
    *,
    env: Any = None,
    physics: str = "auto",
    seed: int = 0,
    episode_length: int | None = None,
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
        policy: the expert. For an environment of Gymnasium it may be any function of an observation
            ``(n,)``, or the name ``module:attribute`` of one.
        num_trajectories: how many episodes.
        env: any environment that :func:`~ailsrs_jax.runs.run.train` takes; by default the task that
            the policy names.
        physics: ``auto``, ``mjx`` or ``mujoco``, for a task given by name.
        seed: of the initial states.
        episode_length: the time limit in environment steps; by default the environment's own, and
            1000 if it has none.
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
    policy: SavedPolicy | PythonPolicy,
    num_trajectories: int,
    *,
    env: Any = None,
    physics: str = "auto",
    seed: int = 0,
    episode_length: int | None = None,
    action_noise: float = 0.0,
) -> Recording:
    """Do as :func:`demonstrate`; also return what :func:`save_minari` needs beside it."""
    require_some(num_trajectories, "trajectories", episode_length)
    if not (math.isfinite(action_noise) and action_noise >= 0):
        raise UserError(f"action_noise is {action_noise}: it must be 0 or more")
    require_seed(seed)
    if env is None:
        if not isinstance(policy, SavedPolicy):
            raise UserError("a function names no environment: hand in env")
        require_harmless(policy.env_id, "the policy")
        env = policy.env_id
    task = open_env(env, physics)
    length = episode_length or env_horizon(task.env)
    if num_trajectories * length >= 2**31:
        raise UserError(
            f"{num_trajectories} trajectories of {length} steps are too many: their steps "
            "are counted in 32 bits, below 2^31"
        )
    if isinstance(policy, SavedPolicy):
        key, noise_std = jax.random.key(seed), action_noise or None
        episodes: Any = roll_out(policy, task.env, num_trajectories, key, length, noise_std)
        env_rewards = np.asarray(episodes.env_rewards)
    else:
        if not isinstance(task.env, GymnasiumEnv):
            raise UserError(
                f"a policy in Python needs an environment of Gymnasium: name it {PREFIX}ID"
            )
        rng = np.random.default_rng(seed)
        noise = rng.normal(size=(num_trajectories, length, task.env.action_size)) * action_noise
        # An evaluation with this seed has the seeds from it on, so that it starts elsewhere.
        seeds = rng.integers(2**31, size=num_trajectories).tolist()
        episodes, env_rewards = task.env.follow(policy, seeds, noise)
    if diverged := np.flatnonzero(episodes.diverged).tolist():
        raise UserError(
            f"episode {diverged[0]} of the expert diverged, and {len(diverged) - 1} more of "
            f"{num_trajectories}: the physics is unstable under this policy"
        )
    demonstrations = Demonstrations(
        observations=np.asarray(episodes.observations),
        actions=np.asarray(episodes.actions),
        lengths=np.asarray(episodes.lengths),
        # In double precision, so that a reader who sums in another order gets the same number.
        returns=env_rewards.sum(axis=1, dtype=np.float64).astype(np.float32),
        env_id=task.env_id,
    )
    return Recording(demonstrations, env_rewards, np.asarray(episodes.final_observations))


def require_some(number: int, of_what: str, episode_length: int | None) -> None:
    """Raise UserError unless at least one step of one episode is asked for."""
    with refusing(f"{number!r} {of_what} asked for"):
        operator.index(number)
    if number < 1 or (episode_length is not None and episode_length < 1):
        raise UserError(
            f"{number} {of_what} of {episode_length} steps asked for: ask for at least one"
        )


def expert_demonstrations(
    env_id: str,
    num_trajectories: int,
    physics: str,
    name: str | None = None,
    *,
    episode_length: int = EPISODE_LENGTH,
    only_cached: bool = False,
) -> Demonstrations:
    """Return demonstrations of an expert that ships with the package, from the cache if possible.

    The file name in the cache is a hash of all that the demonstrations depend on. If the cache
    cannot be read or written, they are simulated again. See
    :func:`~ailsrs_jax.data.policies.expert_path` for the ``name`` of an expert.

    Raises:
        UserError: there is no such expert, or ``only_cached`` and they are not in the cache.
    """
    path = expert_path(env_id, name)
    engine, _ = choose_engine(physics)
    backend = jax.default_backend()
    content = f"{num_trajectories} {engine} {backend} {installed_versions()}".encode()
    if episode_length != EPISODE_LENGTH:
        content += f" {episode_length}".encode()
    file_name = f"{env_id}-{hashlib.sha256(content + path.read_bytes()).hexdigest()[:16]}.npz"
    cached = cache_directory() / "demonstrations" / file_name
    try:
        return load_demonstrations(cached)
    except UserError:
        if only_cached:
            raise
        demonstrations = demonstrate(
            load_policy(path), num_trajectories, physics=engine, episode_length=episode_length
        )
    with contextlib.suppress(UserError):
        save_demonstrations(demonstrations, cached)
    return demonstrations
