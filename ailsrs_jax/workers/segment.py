"""A fixed number of steps of a Gymnasium environment, where one episode follows another."""

from typing import Any, NamedTuple

import numpy as np

from ailsrs_jax.workers.episode import (
    Episode,
    Perceptron,
    Request,
    begin,
    describe,
    make,
    run,
    step,
)


class SegmentRequest(NamedTuple):
    """A segment to be run."""

    policy: Perceptron
    noise: np.ndarray  # (L, p), added to the actions before they are clipped
    seed: int  # of the episode to go on with
    actions: np.ndarray  # (t, p) float32, of that episode so far
    restarts: np.ndarray  # (L,) seeds; the one of the step that ends an episode is the next one's
    episode_length: int
    place: int  # of the segment among those that run beside one another


class Segment(NamedTuple):
    """L steps; those that diverged mean nothing."""

    observations: np.ndarray  # (L, n) float32, what the policy saw
    actions: np.ndarray  # (L, p) float32, clipped
    next_observations: np.ndarray  # (L, n) float32, of the same episode
    rewards: np.ndarray  # (L,) float32
    terminated: np.ndarray  # (L,) bool, the episode ended in a terminal state
    over: np.ndarray  # (L,) bool, it ended there, for whatever reason
    diverged: np.ndarray  # (L,) bool, the step was not finite
    seed: int  # of the episode that is running in the end
    episode_actions: np.ndarray  # (t, p) float32, its actions so far


class Running(NamedTuple):
    """An environment in the middle of an episode."""

    env: Any
    seed: int
    actions: np.ndarray  # (t, p), so far
    observation: np.ndarray


class Environments:
    """The environments of a worker: one for whole episodes, and one for each place of segments.

    A segment goes on with an episode that its seed and its actions determine. The environment of
    its place usually stands there already. If not, the actions are played again, so that the result
    does not depend on the worker.
    """

    def __init__(self, name: Any) -> None:
        """Make an environment; see :func:`~ailsrs_jax.workers.episode.make`."""
        self._name, self._env = name, make(name)
        self.facts = describe(self._env, name)
        self._running: dict[int, Running] = {}

    def answer(self, request: Request | SegmentRequest) -> Episode | Segment:
        """Run an episode or a segment."""
        if isinstance(request, Request):
            return run(self._env, request)
        running = self._find(request)
        segment, self._running[request.place] = _go_on(running, request)
        return segment

    def _find(self, request: SegmentRequest) -> Running:
        """Return the request's environment, in the middle of the request's episode."""
        running = self._running.pop(request.place, None)
        is_there = running is not None and running.seed == request.seed
        if running is not None and is_there and np.array_equal(running.actions, request.actions):
            return running
        env = make(self._name) if running is None else running.env
        observation = begin(env, request.seed)
        for action in request.actions:
            observation, *_ = step(env, observation, action)
        return Running(env, request.seed, request.actions, observation)


def _go_on(running: Running, request: SegmentRequest) -> tuple[Segment, Running]:
    policy, (env, seed, so_far, observation) = request.policy, running
    actions = list(so_far)
    rows = []
    for noise, restart in zip(request.noise, request.restarts.tolist(), strict=True):
        action = np.clip(policy(observation) + noise, policy.action_low, policy.action_high)
        # As it is recorded, so that playing it again gives the same numbers.
        actions.append(np.float32(action))
        following, reward, terminated, truncated, diverged = step(env, observation, actions[-1])
        over = terminated or truncated or diverged or len(actions) == request.episode_length
        rows.append((observation, actions[-1], following, reward, terminated, over, diverged))
        observation = following
        if over:
            seed, actions = restart, []
            observation = begin(env, seed)
    kinds = (np.float32,) * 4 + (bool,) * 3
    columns = map(np.array, zip(*rows, strict=True), kinds)
    so_far = np.array(actions, np.float32).reshape(-1, request.noise.shape[1])
    results: list[Any] = [*columns, seed, so_far]
    return Segment(*results), Running(env, seed, so_far, observation)
