"""The return of a policy, on any engine or in Gymnasium itself."""

import dataclasses

import gymnasium
import jax
import jax.numpy as jnp
import numpy as np

from ailsrs_jax.components.policy import LinearPolicy, repeated
from ailsrs_jax.data.policies import SavedPolicy
from ailsrs_jax.envs import Env
from ailsrs_jax.envs.interface import action_range, env_sizes
from ailsrs_jax.envs.physics.quiet import without_warnings
from ailsrs_jax.envs.registry import TASKS, open_env, resolve_env_id
from ailsrs_jax.errors import UserError
from ailsrs_jax.runs.demonstrate import EPISODE_LENGTH, roll_out
from ailsrs_jax.runs.storage.config import require_seed
from ailsrs_jax.trainers.parts.rollout import simulate

EVALUATION_STREAM = 2**31 - 1  # no demonstration has an episode of this number


@dataclasses.dataclass(frozen=True, eq=False)
class Evaluation:
    """Undiscounted returns and lengths of episodes."""

    returns: np.ndarray  #: (E,), NaN for an episode that diverged
    lengths: np.ndarray  #: (E,)

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
    episode_length: int = EPISODE_LENGTH,
    stochastic: bool = False,
) -> Evaluation:
    """Measure the return of ``policy``.

    >>> import ailsrs_jax as ail
    >>> evaluation = ail.evaluate(ail.load_expert("swimmer"), num_episodes=2)
    >>> print(evaluation)
    35... ± ...
    >>> evaluation.lengths
    array([1000, 1000])

    Args:
        policy: the policy.
        num_episodes: how many episodes.
        physics: ``gymnasium`` runs the policy with NumPy in ``gymnasium.make(env_id)``; ``mjx``,
            ``mujoco`` and ``auto`` simulate our own task. It has no effect if ``env`` is given.
        seed: of the initial states.
        env: any Brax environment; by default the task that the policy names.
        episode_length: the time limit in environment steps.
        stochastic: draw the actions of a Gaussian policy instead of taking their mean.

    Raises:
        UserError: an argument is wrong, or the policy does not fit or is not stochastic.
    """
    if min(num_episodes, episode_length) < 1:
        raise UserError(
            f"{num_episodes} episodes of {episode_length} steps asked for: ask for at least one"
        )
    require_seed(seed)
    in_gymnasium = physics == "gymnasium"
    if in_gymnasium and env is None:
        return _evaluate_in_gymnasium(
            policy.env_id, policy, num_episodes, seed, episode_length, stochastic
        )
    task = open_env(policy.env_id if env is None else env, "auto" if in_gymnasium else physics)
    # These initial states differ from those of demonstrations with the same seed.
    key = jax.random.fold_in(jax.random.key(seed), EVALUATION_STREAM)
    noise_std = policy.noise_std if stochastic else None
    episodes = roll_out(policy, task.env, num_episodes, key, episode_length, noise_std)
    return Evaluation(np.asarray(episodes.env_returns), np.asarray(episodes.lengths))


def evaluate_random(
    env_id: str,
    num_episodes: int = 100,
    physics: str = "gymnasium",
    seed: int = 0,
    *,
    episode_length: int = EPISODE_LENGTH,
) -> Evaluation:
    """Measure the return of uniformly random actions; see :func:`evaluate`."""
    if physics == "gymnasium":
        return _evaluate_in_gymnasium(env_id, None, num_episodes, seed, episode_length)
    env = open_env(env_id, physics).env
    n, p = env_sizes(env)
    low, high = action_range(env)
    still = LinearPolicy(jnp.zeros((p, n)), jnp.zeros(n), jnp.ones(n), low, high)
    noise_key, reset_key = jax.random.split(jax.random.key(seed))
    shape = (num_episodes, episode_length, p)
    noise = jax.random.uniform(noise_key, shape, minval=low, maxval=high)
    keys = jax.random.split(reset_key, num_episodes)
    policies = repeated(still, num_episodes)
    episodes = jax.jit(lambda: simulate(env, policies, keys, episode_length, noise=noise))()
    return Evaluation(np.asarray(episodes.env_returns), np.asarray(episodes.lengths))


def _evaluate_in_gymnasium(
    env_id: str,
    policy: SavedPolicy | None,
    num_episodes: int,
    seed: int,
    episode_length: int,
    stochastic: bool = False,
) -> Evaluation:
    """Measure the return of ``policy``, or of uniformly random actions without one."""
    env_id = resolve_env_id(env_id)
    if env_id not in TASKS:
        raise UserError(
            f"Gymnasium has no {env_id}: choose physics auto, mjx or mujoco, or in Python hand in "
            "env"
        )
    with without_warnings():
        env = gymnasium.make(env_id, max_episode_steps=episode_length)
    observation_shape, action_shape = env.observation_space.shape, env.action_space.shape
    assert observation_shape is not None
    assert action_shape is not None
    if policy is not None:
        policy.require_shape(action_shape[0], observation_shape[0])
    env.action_space.seed(seed)
    returns, lengths = np.zeros(num_episodes), np.zeros(num_episodes, int)
    for episode in range(num_episodes):
        observation, _ = env.reset(seed=seed + episode)
        rng = np.random.default_rng(seed + episode) if stochastic else None
        over = False
        while not over:
            action = env.action_space.sample() if policy is None else policy(observation, rng)
            observation, reward, terminated, truncated, _ = env.step(action)
            returns[episode] += float(reward)
            lengths[episode] += 1
            over = terminated or truncated
    env.close()
    return Evaluation(returns, lengths)
