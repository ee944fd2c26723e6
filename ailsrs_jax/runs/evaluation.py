"""Measure the return of a policy, on any engine or in Gymnasium itself."""

import dataclasses
import logging

import jax
import numpy as np

from ailsrs_jax.components.policy import repeated
from ailsrs_jax.data.policies import SavedPolicy, require_policy
from ailsrs_jax.envs import Env
from ailsrs_jax.envs.gymnasium_env import PREFIX, GymnasiumEnv, GymnasiumStart
from ailsrs_jax.envs.registry import TASKS, is_gymnasium, open_env, require_harmless, resolve_env_id
from ailsrs_jax.errors import UserError
from ailsrs_jax.host_calls import host_errors
from ailsrs_jax.runs.demonstrate import require_some, roll_out
from ailsrs_jax.runs.horizon import env_horizon
from ailsrs_jax.runs.policies import still_policy
from ailsrs_jax.runs.storage.config import require_seed
from ailsrs_jax.trainers.parts.episodes import Episodes
from ailsrs_jax.trainers.parts.rollout import simulate

logger = logging.getLogger(__name__)

EVALUATION_STREAM = 2**31 - 1  # no demonstration has an episode of this number


@dataclasses.dataclass(frozen=True, eq=False)
class Evaluation:
    """Undiscounted returns and lengths of episodes."""

    returns: np.ndarray  #: (E,), NaN for an episode that diverged
    lengths: np.ndarray  #: (E,)

    @classmethod
    def of(cls, episodes: Episodes) -> "Evaluation":
        """Return those of ``episodes``."""
        return cls(np.asarray(episodes.env_returns), np.asarray(episodes.lengths))

    @property
    def mean(self) -> float:
        """Mean return of the episodes that did not diverge; NaN if all diverged."""
        return float(self._finite.mean()) if self._finite.size else np.nan

    @property
    def std(self) -> float:
        """Standard deviation of the return over the same episodes."""
        return float(self._finite.std()) if self._finite.size else np.nan

    @property
    def num_diverged(self) -> int:
        """The number of episodes that diverged."""
        return len(self.returns) - len(self._finite)

    def __str__(self) -> str:
        """Mean ± standard deviation of the return, for people."""
        note = f" ({self.num_diverged} of {len(self.returns)} diverged)"
        return f"{self.mean:.0f} ± {self.std:.0f}" + (note if self.num_diverged else "")

    @property
    def _finite(self) -> np.ndarray:
        return self.returns[np.isfinite(self.returns)]


def evaluate(
    policy: SavedPolicy,
    num_episodes: int = 100,
    physics: str = "gymnasium",
    seed: int = 0,
    *,
    env: Env | None = None,
    episode_length: int | None = None,
    stochastic: bool = False,
) -> Evaluation:
    """Measure the return of ``policy``.

    Returns compare only over episodes of the same time limit. If ``policy`` comes from
    :func:`~ailsrs_jax.runs.run.train` and was trained for episodes of another length, a line says
    so. A policy out of a file does not know what it was trained for.

    >>> import ailsrs_jax as ail
    >>> evaluation = ail.evaluate(ail.load_expert("swimmer"), num_episodes=2)
    >>> print(evaluation)
    35... ± ...
    >>> evaluation.lengths.tolist()
    [1000, 1000]

    Args:
        policy: the policy.
        num_episodes: how many episodes.
        physics: ``gymnasium`` runs the policy with NumPy in ``gymnasium.make(env_id)``, where
            episode ``i`` has the seed ``seed + i``; ``mjx``, ``mujoco`` and ``auto`` simulate our
            own task. Leave it out if ``env`` is an environment.
        seed: of the initial states.
        env: any environment that :func:`~ailsrs_jax.runs.run.train` takes; by default the task that
            the policy names, if it is registered or was named in this process before.
        episode_length: the time limit in environment steps; by default the environment's own, and
            1000 if it has none.
        stochastic: draw the actions of a Gaussian policy instead of taking their mean.

    Raises:
        UserError: an argument is wrong, or the policy does not fit or is not stochastic.
    """
    episodes = evaluation_episodes(
        policy, num_episodes, physics, seed, env, episode_length, stochastic=stochastic
    )
    return Evaluation.of(episodes)


def evaluation_episodes(
    policy: SavedPolicy,
    num_episodes: int,
    physics: str,
    seed: int = 0,
    env: Env | None = None,
    episode_length: int | None = None,
    *,
    stochastic: bool = False,
) -> Episodes:
    """Return the episodes that :func:`evaluate` measures."""
    require_policy(policy)
    require_some(num_episodes, "episodes", episode_length)
    require_seed(seed)
    if env is None:
        require_harmless(policy.env_id, "the policy")
    task = _open(policy.env_id if env is None else env, physics)
    length = episode_length or env_horizon(task)
    if policy.episode_length not in (None, length):
        logger.warning(
            "evaluating over %d steps a policy that was trained over %d: the returns of the two do "
            "not compare; set episode_length=%d",
            *(length, policy.episode_length, policy.episode_length),
        )
    noise_std = policy.noise_std if stochastic else None
    # These initial states differ from those of demonstrations with the same seed.
    key = jax.random.fold_in(jax.random.key(seed), EVALUATION_STREAM)
    starts = _resets(task, seed, num_episodes)
    return roll_out(policy, task, num_episodes, key, length, noise_std, starts)


def evaluate_random(env_id: str, physics: str, episode_length: int) -> Evaluation:
    """Measure the return of uniformly random actions in 100 episodes; see :func:`evaluate`."""
    env, num_episodes = _open(env_id, physics), 100
    still = still_policy(env)
    low, high = still.action_low, still.action_high
    noise_key, reset_key = jax.random.split(jax.random.key(0))
    shape = num_episodes, episode_length, len(low)
    noise = jax.random.uniform(noise_key, shape, minval=low, maxval=high)
    resets = _resets(env, 0, num_episodes)
    starts = jax.random.split(reset_key, num_episodes) if resets is None else resets
    policies = repeated(still, num_episodes)
    with host_errors():
        run = jax.jit(lambda: simulate(env, policies, starts, episode_length, noise=noise))
        episodes = jax.block_until_ready(run())
    return Evaluation.of(episodes)


def _open(env: Env | str, physics: str) -> Env:
    """Return the environment; with the physics ``gymnasium``, Gymnasium's own of this name."""
    if physics != GymnasiumEnv.backend:
        return open_env(env, physics).env
    if isinstance(env, str) and not is_gymnasium(env):
        env_id = resolve_env_id(env)
        if env_id not in TASKS:
            raise UserError(
                f"Gymnasium has no {env_id}: choose physics auto, mjx or mujoco, or in Python hand "
                "in env"
            )
        env = PREFIX + env_id
    return open_env(env).env


def _resets(env: Env, seed: int, num_episodes: int) -> GymnasiumStart | None:
    """Return resets by seed, which give the same episodes to anybody, if Gymnasium takes them."""
    if not isinstance(env, GymnasiumEnv):
        return None
    return env.resets(((seed + np.arange(num_episodes)) % 2**31).tolist())
