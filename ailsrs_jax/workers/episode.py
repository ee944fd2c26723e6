"""One whole episode of a Gymnasium environment, with a policy in NumPy."""

import contextlib
from collections.abc import Callable
from typing import Any, NamedTuple

import gymnasium
import numpy as np
from gymnasium.spaces import Box, Dict, Tuple
from gymnasium.wrappers import FlattenObservation

from ailsrs_jax.own_code import is_own, load_own, search_here

LARGEST = 1e10  # beyond this, as in MuJoCo, a simulation counts as diverged


class Facts(NamedTuple):
    """What has to be known about an environment."""

    observation_size: int
    action_low: np.ndarray  # (p,) float32
    action_high: np.ndarray  # (p,)
    time_limit: int | None  # of its specification, in steps
    sets_observations: bool  # can be put into the state that a given observation is made in


class Perceptron(NamedTuple):
    """A multilayer perceptron of standardised observations; a linear policy has one layer."""

    layers: tuple[tuple[np.ndarray, np.ndarray], ...]  # weights (in, out), biases (out,)
    mean: np.ndarray  # (n,)
    std: np.ndarray  # (n,)
    action_low: np.ndarray  # (p,)
    action_high: np.ndarray  # (p,)

    def __call__(self, observation: np.ndarray) -> np.ndarray:
        """Return the action ``(p,)`` before it is clipped."""
        numbers = (observation - self.mean) / self.std
        for layer, (weights, biases) in enumerate(self.layers):
            numbers = (np.tanh(numbers) if layer else numbers) @ weights + biases
        return numbers


class Request(NamedTuple):
    """An episode to be run."""

    policy: Perceptron | str | Callable[[np.ndarray], Any]  # or ``module:attribute``
    noise: np.ndarray  # (T, p), added to the actions before they are clipped; (0, p) for none
    seed: int
    start: np.ndarray | None  # (n,) the first observation, if it is not that of a reset
    episode_length: int  # T

    place: None = None  # any worker will do


class Episode(NamedTuple):
    """L live steps."""

    observations: np.ndarray  # (L, n) float32, what the policy saw
    actions: np.ndarray  # (L, p) float32, clipped
    rewards: np.ndarray  # (L,) float32
    final_observation: np.ndarray  # (n,) float32, after the last step
    diverged: bool  # the next step would not be finite


def make(name: str | Callable[[], gymnasium.Env], render_mode: str | None = None) -> gymnasium.Env:
    """Make an environment that observes a vector; its time limit is left out.

    Args:
        name: what ``gymnasium.make`` takes, or a function that returns an environment.
        render_mode: of an environment by name, such as ``rgb_array``.

    Raises:
        TypeError: observations or actions are not of a kind that our policies can handle.
    """
    if isinstance(name, str):
        if is_own(name):
            search_here()
        options = {"render_mode": render_mode} if render_mode else {}  # not every one has it
        env = gymnasium.make(name, max_episode_steps=-1, disable_env_checker=True, **options)
    else:
        env = name()
    observed = env.observation_space
    if not isinstance(observed, Box | Dict | Tuple) or not observed.is_np_flattenable:
        raise TypeError(f"it observes {observed}, which is no vector of numbers")
    if not isinstance(observed, Box) or len(observed.shape) != 1:
        env = FlattenObservation(env)
    space = env.action_space
    if not isinstance(space, Box) or not np.issubdtype(space.dtype, np.floating):
        raise TypeError(f"its actions are {space}: they must be a Box of real numbers")
    if not space.is_bounded():
        raise TypeError(f"its actions are {space}: give them a finite range")
    return env


def describe(env: Any, name: str | Callable[[], gymnasium.Env]) -> Facts:
    """Return the facts about the environment ``env`` that :func:`make` made for ``name``."""
    # A specification by name still has the limit that ``make`` has left out. The module in front of
    # it has been imported.
    spec = gymnasium.spec(name.rpartition(":")[2]) if isinstance(name, str) else env.spec
    return Facts(
        observation_size=env.observation_space.shape[0],
        action_low=np.float32(env.action_space.low).ravel(),
        action_high=np.float32(env.action_space.high).ravel(),
        time_limit=spec.max_episode_steps if spec is not None else None,
        sets_observations=find_setter(env) is not None,
    )


def run(env: Any, request: Request) -> Episode:
    """Run an episode, which ends early when the environment says so or diverges."""
    noise, policy, space = request.noise, request.policy, env.action_space
    low, high = np.ravel(space.low), np.ravel(space.high)
    if isinstance(policy, Perceptron):
        low, high = policy.action_low, policy.action_high
    elif isinstance(policy, str):
        policy = load_own(policy)
    observation = begin(env, request.seed, request.start)
    observations: list[np.ndarray] = []
    actions: list[np.ndarray] = []
    rewards: list[float] = []
    diverged = False
    while len(rewards) < request.episode_length and not diverged:
        action = np.ravel(policy(observation))
        action = action + noise[len(rewards)] if len(noise) else action
        action = np.clip(action, low, high)
        following, reward, terminated, truncated, diverged = step(env, observation, action)
        if not diverged:
            observations.append(observation)
            actions.append(action)
            rewards.append(reward)
            observation = following
            if terminated or truncated:
                break
    return Episode(
        np.array(observations, np.float32).reshape(-1, len(observation)),
        np.array(actions, np.float32).reshape(-1, len(low)),
        np.array(rewards, np.float32),
        np.asarray(observation, np.float32),
        diverged,
    )


def step(
    env: Any, observation: np.ndarray, action: np.ndarray
) -> tuple[np.ndarray, float, bool, bool, bool]:
    """Apply ``action (p,)`` where ``observation (n,)`` was made.

    Return what ``env.step`` does, and whether a number of the step is not finite.
    """
    following, reward, terminated, truncated, _ = env.step(action.reshape(env.action_space.shape))
    following = np.array(following)  # a copy, because it may be the state that the next step moves
    # Comparisons with NaN are false.
    finite = (np.abs(x) <= LARGEST for x in (observation, action, following, reward))
    return following, reward, terminated, truncated, not all(map(np.all, finite))


def begin(env: Any, seed: int, start: np.ndarray | None = None) -> np.ndarray:
    """Start an episode, at a reset or where ``start (n,)`` is observed; return the observation."""
    observation = env.reset(seed=seed)[0]
    if start is None:
        return np.array(observation)  # see step()
    find_setter(env)(start)  # type: ignore[misc]
    return np.asarray(start, float)


def find_setter(env: Any) -> Callable[[np.ndarray], object] | None:
    """Return the function that puts ``env`` into the state in which an observation is made.

    It is the method ``set_observation`` of the environment or of a wrapper. Gymnasium's MuJoCo
    environments need none if they observe positions and velocities.
    """
    with contextlib.suppress(AttributeError):
        return env.get_wrapper_attr("set_observation")
    base = env.unwrapped
    structure = {"skipped_qpos": 0, "qpos": 0, "qvel": 0}
    structure.update(getattr(base, "observation_structure", {}))
    skipped, num_positions, num_velocities = list(structure.values())[:3]

    def set_observation(observation: np.ndarray) -> None:
        positions, velocities, _ = np.split(
            observation, [num_positions, num_positions + num_velocities]
        )
        base.set_state(np.append(base.init_qpos[:skipped], positions), np.float64(velocities))

    model = getattr(base, "model", None)
    sizes = (getattr(model, "nq", None), getattr(model, "nv", None))
    return set_observation if sizes == (skipped + num_positions, num_velocities) else None
