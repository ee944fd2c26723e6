"""One episode of a policy with the poses to draw."""

import dataclasses
import functools
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import gymnasium
import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from ailsrs_jax.components.policy import Policy
from ailsrs_jax.data.policies import SavedPolicy
from ailsrs_jax.envs import Env, State
from ailsrs_jax.envs.gymnasium_env import PREFIX, GymnasiumEnv
from ailsrs_jax.envs.interface import env_name, env_sizes
from ailsrs_jax.envs.registry import open_env, require_harmless
from ailsrs_jax.envs.tasks.mujoco_task import MujocoTask
from ailsrs_jax.errors import UserError, refusing
from ailsrs_jax.runs.demonstrate import roll_out
from ailsrs_jax.runs.evaluation import EVALUATION_STREAM
from ailsrs_jax.runs.horizon import env_horizon
from ailsrs_jax.runs.policies import jax_policy
from ailsrs_jax.runs.storage.config import require_seed
from ailsrs_jax.workers.episode import begin, make


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Episode:
    """An episode of T live steps."""

    env_rewards: np.ndarray  # (T,)
    dt: float  # [s] of an environment step
    ended: bool  # in a terminal state, before the time limit

    @property
    def num_steps(self) -> int:
        """T, the number of live steps."""
        return len(self.env_rewards)


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Replay(Episode):
    """An episode that MuJoCo draws."""

    model: mujoco.MjModel
    positions: np.ndarray  # (T + 1, nq) MuJoCo's qpos [m, rad], from the initial pose on


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Film(Episode):
    """An episode of an environment of Gymnasium, which draws itself."""

    name: str  # for gymnasium.make
    actions: np.ndarray  # (T, p)
    seed: int

    def pictures(self, steps: Sequence[int]) -> Iterator[np.ndarray]:
        """Yield what the environment draws after each of the increasing ``steps``, uint8.

        Raises:
            UserError: it draws nothing.
        """
        with refusing(f"{PREFIX}{self.name} cannot be rendered"):
            env = make(self.name, "rgb_array")
            begin(env, self.seed)
            time = 0
            for step in steps:
                for action in self.actions[time:step]:
                    env.step(action.reshape(env.action_space.shape))
                time = step
                picture = env.render()
                if not isinstance(picture, np.ndarray):
                    raise TypeError("it has no render mode rgb_array")
                yield picture
            env.close()


def film(policy: SavedPolicy, env: GymnasiumEnv, seed: int, seconds: float, limit: int) -> Film:
    """Run one episode of ``policy``, the first that ``evaluate`` runs with this seed.

    Raises:
        UserError: the environment has no name, or fails, or the episode diverges.
    """
    name = env.env_id.removeprefix(PREFIX)
    with refusing(f"{env.env_id} cannot be rendered"):
        spec = gymnasium.make(name)
        per_second = spec.metadata.get("render_fps") or 30
        spec.close()
    num_steps = int(np.clip(np.ceil(seconds * per_second), 1, limit))
    starts = env.resets([seed])
    episodes = roll_out(policy, env, 1, jax.random.key(seed), num_steps, starts=starts)
    if episodes.diverged.any():
        raise UserError("the episode diverged: the environment is unstable under this policy")
    length = int(episodes.lengths[0])
    return Film(
        name=name,
        actions=np.asarray(episodes.actions[0, :length]),
        seed=seed,
        env_rewards=np.asarray(episodes.env_rewards[0, :length]),
        dt=1 / per_second,
        ended=length < num_steps,
    )


def replay(
    policy: SavedPolicy,
    *,
    env: Env | None = None,
    physics: str = "auto",
    seed: int = 0,
    seconds: float = np.inf,
    episode_length: int | None = None,
) -> Replay | Film:
    """Roll out one episode: the first that ``evaluate`` simulates on the same engine.

    It is cut off after ``seconds`` of simulated time, or after ``episode_length`` environment
    steps, by default the environment's own limit. The other arguments are those of
    :func:`~ailsrs_jax.show.video.render`.

    Raises:
        UserError: the task is unknown or not simulated by MuJoCo, the policy does not fit it, or
            the episode diverges.
    """
    if not seconds > 0:
        raise UserError(f"seconds is {seconds}: it must be positive")
    require_seed(seed)
    if env is None:
        require_harmless(policy.env_id, "the policy")
    task = open_env(policy.env_id if env is None else env, physics)
    limit = episode_length or env_horizon(task.env)
    if isinstance(task.env, GymnasiumEnv):
        return film(policy, task.env, seed, seconds, limit)
    model, _ = mujoco_view(task.env)
    n, p = env_sizes(task.env)
    policy.require_shape(p, n)
    dt = float(task.env.dt)
    num_steps = int(np.clip(np.ceil(seconds / dt - 1e-6), 1, limit))
    key = jax.random.fold_in(jax.random.key(seed), EVALUATION_STREAM)
    episode = _compiled_episode(task.env, num_steps)(jax_policy(policy), jax.random.fold_in(key, 0))
    first, (positions, env_rewards, done) = jax.tree.map(np.asarray, episode)
    ends = np.flatnonzero(done)
    length = int(ends[0]) + 1 if len(ends) else num_steps
    if not (np.isfinite(positions[:length]).all() and np.isfinite(env_rewards[:length]).all()):
        raise UserError("the episode diverged: the physics is unstable under this policy")
    return Replay(
        model=model,
        positions=np.concatenate([first[None], positions[:length]]),
        env_rewards=env_rewards[:length],
        dt=dt,
        ended=bool(len(ends)),
    )


@functools.lru_cache(maxsize=4)
def _compiled_episode(env: Env, num_steps: int) -> Callable[[Policy, jax.Array], Any]:
    """Return a function to the initial positions, and to positions, rewards and ends of all steps.

    Values after the end of an episode are meaningless.
    """
    _, positions_of = mujoco_view(env)

    def episode(policy: Policy, key: jax.Array) -> Any:
        def step(state: State, _: None) -> tuple[State, Any]:
            after = env.step(state, policy(state.obs))
            return after, (positions_of(after), after.reward, after.done)

        start = env.reset(key)
        return positions_of(start), jax.lax.scan(step, start, length=num_steps)[1]

    return jax.jit(episode)


def mujoco_view(env: Env) -> tuple[mujoco.MjModel, Callable[[State], jax.Array]]:
    """Return the model that ``env`` simulates and the function from its state to ``qpos (nq,)``.

    Raises:
        UserError: MuJoCo does not simulate it.
    """
    inner: Any = getattr(env, "unwrapped", env)
    if isinstance(inner, MujocoTask):
        return inner.physics.model, lambda state: state.pipeline_state.qpos
    if isinstance(getattr(inner, "mj_model", None), mujoco.MjModel):  # MuJoCo Playground's
        return inner.mj_model, lambda state: state.data.qpos
    model = getattr(getattr(inner, "sys", None), "mj_model", None)
    if isinstance(model, mujoco.MjModel):  # Brax's, with any backend
        return model, lambda state: jnp.asarray(state.pipeline_state.q)
    raise UserError(
        f"{env_name(env)} cannot be rendered: it is not simulated by MuJoCo, so there is no model "
        "to draw"
    )
