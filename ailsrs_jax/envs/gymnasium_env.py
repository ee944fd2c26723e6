"""Any Gymnasium environment, simulated by worker processes."""

import itertools
from collections.abc import Callable, Sequence
from typing import Any

import cloudpickle
import gymnasium
import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from ailsrs_jax.envs.physics import Perceptrons, Segments, Trajectories
from ailsrs_jax.envs.physics.base import segment_types, trajectory_types
from ailsrs_jax.errors import UserError, refusing
from ailsrs_jax.host_calls import host_call, zeros
from ailsrs_jax.versions import available_cores
from ailsrs_jax.workers.episode import Perceptron, Request
from ailsrs_jax.workers.pool import Pool
from ailsrs_jax.workers.process import ProcessWorker
from ailsrs_jax.workers.segment import SegmentRequest

PREFIX = "gymnasium:"
LARGEST_SEED = 2**31 - 1
WORKER_TIMEOUT = 600.0  # seconds


class GymnasiumStart(struct.PyTreeNode):
    """Where an episode begins."""

    seed: jax.Array  # () int32, of the environment's reset
    observation: jax.Array  # (n,) of the state that it is put into then; NaN if it stays there


class Unfinished(struct.PyTreeNode):
    """Episodes that go on, each described by its seed and its actions so far."""

    seed: jax.Array  # (S,) int32
    actions: jax.Array  # (S, T, p) float32 so far, then zeros


class GymnasiumEnv:
    """An environment that only runs whole episodes, of policies that the workers know in NumPy.

    It has no ``reset`` and ``step`` in JAX. Its episodes do not depend on the number of workers,
    if the environment itself does the same after the same ``reset(seed=...)``.
    """

    runs_episodes = runs_segments = True
    backend = "gymnasium"

    def __init__(
        self,
        name: str | Callable[[], gymnasium.Env],
        workers: int | str | None = None,
        worker_timeout: float = WORKER_TIMEOUT,
    ) -> None:
        """Make the environment in a first worker.

        Args:
            name: what ``gymnasium.make`` takes, or a function that makes an environment.
            workers: the number of processes, by default one for each core; or ``ray:N`` for N
                actors on a Ray cluster.
            worker_timeout: seconds that an episode may take before its worker is replaced.

        Raises:
            UserError: it cannot be made, or does not observe and act in vectors of numbers.
        """
        self.env_id = PREFIX + _name_of(name)
        with refusing(f"{self.env_id} cannot be sent to a worker"):
            cloudpickle.dumps(name)
        number, kind = _parse_workers(workers)
        if not worker_timeout > 0:
            raise UserError(f"worker_timeout is {worker_timeout}: it must be positive")
        self._pool = Pool(name, self.env_id, number, kind, worker_timeout)
        facts = self._pool.describe()
        self.observation_size, self.action_size = facts.observation_size, len(facts.action_low)
        self.action_low, self.action_high = facts.action_low, facts.action_high
        self.time_limit, self.sets_observations = facts.time_limit, facts.sets_observations

    def draw_start(self, key: jax.Array) -> GymnasiumStart:
        """Return a reset with a seed drawn with ``key``."""
        seed = jax.random.randint(key, (), 0, LARGEST_SEED)
        return GymnasiumStart(seed, jnp.full(self.observation_size, jnp.nan))

    def resets(self, seeds: Sequence[int] | jax.Array) -> GymnasiumStart:
        """Return resets with ``seeds (B,)``."""
        nowhere = jnp.full((len(seeds), self.observation_size), jnp.nan)
        return GymnasiumStart(jnp.asarray(seeds, jnp.int32), nowhere)

    def state_at(self, observation: jax.Array, key: jax.Array | None = None) -> GymnasiumStart:
        """Return the state in which ``observation (n,)`` is made.

        ``key`` draws what else is random there. Without it, this is always the same.

        Only environments with ``sets_observations`` can start there; see
        :func:`~ailsrs_jax.workers.episode.find_setter`.
        """
        seed = jnp.zeros((), jnp.int32) if key is None else self.draw_start(key).seed
        return GymnasiumStart(seed, observation)

    def run_episodes(
        self,
        policies: Perceptrons,
        starts: GymnasiumStart,
        noise: jax.Array,
        episode_length: int,
    ) -> tuple[Trajectories, jax.Array]:
        """Simulate an episode of each policy; see ``MujocoTask.run_episodes``."""

        def run(policies: Perceptrons, starts: Any, noise: np.ndarray) -> Any:
            states = [None if np.isnan(each).any() else each for each in starts.observation]
            rows = zip(_perceptrons(policies), noise, starts.seed.tolist(), states, strict=True)
            return self._run_requests([Request(*row, episode_length) for row in rows])

        types = self._types(len(noise), episode_length)
        return host_call(run, types, policies, starts, noise)

    def begin_segments(self, starts: GymnasiumStart, episode_length: int) -> Unfinished:
        """Return what :meth:`run_segments` goes on from, after the resets of S episodes."""
        shape = (len(starts.seed), episode_length, self.action_size)
        return Unfinished(starts.seed, jnp.zeros(shape))

    def run_segments(
        self,
        policies: Perceptrons,
        states: Unfinished,
        times: jax.Array,
        restarts: GymnasiumStart,
        noise: jax.Array,
        episode_length: int,
    ) -> tuple[Unfinished, jax.Array, Segments, jax.Array]:
        """Go on with S episodes for L steps each; see ``MujocoTask.run_segments``.

        The ``restarts`` are resets.
        """
        segments = segment_types(noise.shape[:2], self.observation_size, self.action_size)
        rewards = jax.ShapeDtypeStruct(noise.shape[:2], np.float32)
        types = jax.eval_shape(lambda *x: x, states, times, segments, rewards)

        def run(
            policies: Perceptrons, states: Any, times: Any, seeds: np.ndarray, noise: np.ndarray
        ) -> Any:
            so_far = [actions[:time] for actions, time in zip(states.actions, times)]
            rows = zip(_perceptrons(policies), noise, states.seed.tolist(), so_far, seeds)
            requests = [SegmentRequest(*row, episode_length, i) for i, row in enumerate(rows)]
            *columns, last_seeds, actions = zip(*self._pool.run(requests), strict=True)
            observations, taken, following, rewards, *ends = map(np.stack, columns)
            padded = np.zeros_like(states.actions)
            for row, numbers in zip(padded, actions, strict=True):
                row[: len(numbers)] = numbers
            return (
                Unfinished(np.array(last_seeds, np.int32), padded),  # type: ignore[arg-type]
                np.array(list(map(len, actions)), np.int32),
                Segments(observations, taken, following, *ends),
                rewards,
            )

        return host_call(run, types, policies, states, times, restarts.seed, noise)

    def follow(
        self, policy: str | Callable[[np.ndarray], Any], seeds: Sequence[int], noise: np.ndarray
    ) -> tuple[Trajectories, np.ndarray]:
        """Run episodes of any policy, and return them with their rewards ``(B, T)``.

        Args:
            policy: a function of an observation ``(n,)``, or its name ``module:attribute``, which
                each worker imports. Its actions are clipped to the environment's range.
            seeds: ``B`` seeds for the environment's ``reset``.
            noise: ``(B, T, p)``, added to the actions before they are clipped.

        Raises:
            UserError: the policy or the environment has raised an exception.
        """
        rows = zip(noise, seeds, strict=True)
        return self._run_requests([Request(policy, *row, None, noise.shape[1]) for row in rows])

    def _run_requests(self, requests: Sequence[Request]) -> tuple[Trajectories, np.ndarray]:
        types = self._types(len(requests), requests[0].episode_length)
        run, rewards = zeros(types)
        for i, episode in enumerate(self._pool.run(requests)):
            length = len(episode.rewards)
            run.observations[i, :length] = episode.observations
            run.actions[i, :length] = episode.actions
            run.final_observations[i] = episode.final_observation
            run.lengths[i], run.diverged[i] = length, episode.diverged
            rewards[i, :length] = episode.rewards
        return run, rewards

    def _types(self, num_episodes: int, episode_length: int) -> tuple[Trajectories, Any]:
        """Return the shapes and types of episodes and of their rewards."""
        sizes = self.observation_size, self.action_size
        episodes = trajectory_types(num_episodes, episode_length, *sizes)
        return episodes, jax.ShapeDtypeStruct((num_episodes, episode_length), np.float32)


def _name_of(env: str | Callable[[], gymnasium.Env]) -> str:
    """Return the name of an environment; a function of ``functools.partial`` has no own name."""
    if isinstance(env, str):
        return env
    function = getattr(env, "func", env)
    return str(getattr(function, "__name__", type(function).__name__))


def _perceptrons(policies: Perceptrons) -> list[Perceptron]:
    """Return each of the policies, as the workers take them."""
    shapes = list(itertools.pairwise(policies.sizes))
    ends = np.cumsum([size for n, p in shapes for size in (n * p, p)])[:-1]

    def layers(parameters: np.ndarray) -> tuple[tuple[np.ndarray, np.ndarray], ...]:
        parts = np.split(parameters, ends)
        weights = [matrix.reshape(shape) for matrix, shape in zip(parts[::2], shapes)]
        return tuple(zip(weights, parts[1::2]))

    return [
        Perceptron(layers(parameters), *others)
        for parameters, *others in zip(*jax.tree.leaves(policies), strict=True)
    ]


def _parse_workers(workers: int | str | None) -> tuple[int, Any]:
    """Return how many workers, and of which kind."""
    where, _, number = str(available_cores() if workers is None else workers).rpartition(":")
    if where not in ("", "ray") or not number.isdecimal() or int(number) < 1:
        raise UserError(f"workers is '{workers}': give a number, or ray: and a number")
    if where == "":
        return int(number), ProcessWorker
    try:
        from ailsrs_jax.workers.ray_worker import RayWorker
    except ImportError as error:
        raise UserError("workers on Ray need it: pip install 'ailsrs_jax[ray]'") from error
    return int(number), RayWorker
