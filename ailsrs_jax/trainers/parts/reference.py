"""Demonstrations as imitation learners use them, and the distance of other episodes to them."""

import logging
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax
from flax import struct

from ailsrs_jax.components import normalizer
from ailsrs_jax.components.energy_distance import energy_distance, mean_distance
from ailsrs_jax.components.normalizer import RunningStatistics
from ailsrs_jax.components.sampling import sample_steps
from ailsrs_jax.data.demonstrations import Demonstrations
from ailsrs_jax.envs.interface import env_sizes, starts_at_observations
from ailsrs_jax.errors import UserError
from ailsrs_jax.trainers.parts.episodes import Episodes
from ailsrs_jax.trainers.parts.rollout import Starts
from ailsrs_jax.trainers.parts.settings import is_used, parse_entries

logger = logging.getLogger(__name__)

# Energy distances of evaluations at which policies had most of the expert's return, and at most
# half of it, on HalfCheetah and Hopper; see experiments/search/README.md.
CLOSE, FAR = 0.3, 1.0


class Reference(struct.PyTreeNode):
    """The expert's steps, prepared by :func:`make_reference`."""

    observations: jax.Array  # (E, T, n) in units of the expert's standard deviation
    actions: jax.Array  # (E, T, p), or (E, T, 0) if they are not known
    lengths: jax.Array  # (E,) int32
    statistics: RunningStatistics  # of the expert's observations
    distance_features: jax.Array  # (m, n + p + 1), drawn once; without p if it is not known
    distance_spread: jax.Array  # () mean distance among them
    stride: int = struct.field(pytree_node=False)  # environment steps between its own
    #: the first entry of an observation that is compared with the policy's, and the one after them
    entries: tuple[int, int] = struct.field(pytree_node=False)

    def require_actions(self, what_for: str) -> None:
        """Raise UserError, which names ``what_for``, unless the expert's actions are known."""
        if self.actions.shape[-1] == 0:
            raise UserError(
                f"the demonstrations hold no actions, which {what_for} needs, and they are "
                "inferred only from every step in a simulator that can be put into a state"
            )

    def require_comparable(self, search_length: int, episode_length: int) -> None:
        """Raise UserError unless ``energy_share`` can judge episodes of ``search_length`` steps.

        The expert's side of the distance is whole demonstrations, falls included.
        """
        whole, shorter = (
            distance_horizon(self.observations, self.stride, limit)
            for limit in (episode_length, search_length)
        )
        if shorter < 1:
            raise UserError(
                f"only every {self.stride}th step of the demonstrations is kept: search_length is "
                f"{search_length}, energy_share needs at least {self.stride}"
            )
        if shorter < whole and (np.asarray(self.lengths) < whole).any():
            raise UserError(
                "some demonstrations end early, so energy_share would reward early ends in "
                f"episodes of {search_length} steps: set energy_share or search_length to 0"
            )

    @property
    def alive(self) -> jax.Array:
        """``(E, T)`` bool: the step happened."""
        return jnp.arange(self.observations.shape[1]) < self.lengths[:, None]

    def compared(self, observations: jax.Array) -> jax.Array:
        """Return the compared entries of observations ``(..., n)``, standardised.

        The scale is fixed, so a reward that depends on it does not drift while the policy's own
        statistics move.
        """
        return self.statistics.standardize(observations)[..., slice(*self.entries)]

    @property
    def compared_observations(self) -> jax.Array:
        """The compared entries of the expert's observations, standardised, ``(E, T, ·)``."""
        return self.observations[..., slice(*self.entries)]

    @property
    def points(self) -> jax.Array:
        """The expert's steps as they are compared: entries and known actions, ``(E, T, ·)``."""
        return jnp.concatenate([self.compared_observations, self.actions], axis=-1)

    def points_of(self, observations: jax.Array, actions: jax.Array) -> jax.Array:
        """Return the same of a policy's ``observations (..., n)`` and ``actions (..., p)``."""
        actions = actions[..., : self.actions.shape[-1]]
        return jnp.concatenate([self.compared(observations), actions], axis=-1)

    def unstandardize(self, observations: jax.Array) -> jax.Array:
        """Return standardised observations ``(..., n)`` in the environment's units."""
        return observations * self.statistics.std + self.statistics.mean

    def draw_starts(
        self, env: Any, key: jax.Array, num_starts: int, demonstrated: jax.Array | float
    ) -> Starts:
        """Draw ``(num_starts,)`` starts: the task's own resets, and states of the demonstrations.

        The share ``demonstrated`` of them are demonstrated states, drawn uniformly from all. A
        share that makes no whole number is met on average. If ``env`` cannot be put into a state,
        all starts are resets.
        """
        reset_key, step_key, share_key = jax.random.split(key, 3)
        resets = jax.random.split(reset_key, num_starts)
        if not is_used(demonstrated) or not starts_at_observations(env):
            return resets
        episode, time = sample_steps(step_key, self.lengths, num_starts)
        observed = self.unstandardize(self.observations[episode, time])
        states = jax.vmap(env.state_at)(observed, resets)
        # Systematic sampling: each start counts with the probability ``demonstrated``.
        edges = jnp.floor(demonstrated * jnp.arange(num_starts + 1) + jax.random.uniform(share_key))
        chosen = jnp.diff(edges) > 0
        return jax.vmap(optax.tree.where)(chosen, states, jax.vmap(env.draw_start)(resets))

    def distance(self, key: jax.Array, episodes: Episodes, episode_length: int) -> jax.Array:
        """Return the energy distance of ``episodes`` to the expert's; see :meth:`distances`."""
        num_samples = len(self.distance_features)
        return self.distances(key, episodes, episode_length, 1, num_samples)[0]

    def distances(
        self,
        key: jax.Array,
        episodes: Episodes,
        episode_length: int,
        num_groups: int,
        num_samples: int,
    ) -> jax.Array:
        """Return the energy distances ``(num_groups,)`` of groups of ``episodes`` to the expert's.

        The groups follow one another and have the same size; ``num_samples`` steps of each are
        compared. The environment's reward is not used. An episode that diverged counts as one that
        ended at once.
        """
        horizon = self.stride * distance_horizon(self.observations, self.stride, episode_length)
        points = self.points_of(episodes.observations, episodes.actions)

        def of_group(group: tuple[jax.Array, jax.Array, jax.Array]) -> jax.Array:
            features = distance_features(*group, horizon, num_samples)
            return energy_distance(features, self.distance_features, self.distance_spread)

        groups = jax.tree.map(
            lambda x: x.reshape(num_groups, -1, *x.shape[1:]), (points, episodes.usable_lengths)
        )
        keys = jax.random.split(key, num_groups)
        # A few at a time, because all pairs of samples of all groups are too many numbers.
        return jax.lax.map(of_group, (keys, *groups), batch_size=min(num_groups, 8))


def verdict(distance: float) -> str:
    """Say what the energy ``distance`` of a policy to the expert means."""
    if distance <= CLOSE:
        return "close to the expert"
    return "in part like the expert" if distance <= FAR else "not like the expert"


def require_sizes(demonstrations: Demonstrations, env: Any) -> None:
    """Raise UserError unless the steps of the demonstrations are as large as those of ``env``."""
    n, p = env_sizes(env)
    actions = demonstrations.actions
    observed = demonstrations.observations.shape[-1]
    acted = p if actions is None else actions.shape[-1]
    if (observed, acted) != (n, p):
        raise UserError(
            f"the demonstrations have {observed} observations and "
            f"{'no' if actions is None else acted} actions: the environment has {n} and {p}"
        )


def make_reference(
    demonstrations: Demonstrations,
    episode_length: int,
    num_distance_samples: int,
    entries: str = "all",
    leave_out_beyond: float = 0.0,
) -> Reference:
    """Prepare ``demonstrations`` for episodes of at most ``episode_length`` steps.

    Args:
        demonstrations: the expert's episodes.
        episode_length: T.
        num_distance_samples: steps that are compared for a distance.
        entries: of the observations that are compared, ``all`` or ``first:end``.
        leave_out_beyond: see :func:`unlike_the_others`; 0: no episode is left out.

    Raises:
        UserError: the demonstrations are subsampled, and an episode is too short for one step; or
            all of them are left out.
    """
    if leave_out_beyond > 0.0:
        with jax.ensure_compile_time_eval():  # how many are left out is a shape
            whole = make_reference(demonstrations, episode_length, num_distance_samples, entries)
            horizon = distance_horizon(whole.observations, whole.stride, episode_length)
            unlike = unlike_the_others(whole, horizon, leave_out_beyond)
        if unlike.any():
            numbers = ", ".join(map(str, np.flatnonzero(unlike)))
            if unlike.all():
                raise UserError(
                    f"leave_out_beyond is {leave_out_beyond}: no demonstration is left; make it at "
                    "least 1"
                )
            logger.warning("demonstrations left out, because they are unlike most: %s", numbers)
        demonstrations = jax.tree.map(lambda x: x[~unlike], demonstrations)
    observations, alive = map(jnp.asarray, (demonstrations.observations, demonstrations.alive))
    with jax.ensure_compile_time_eval():  # require_comparable looks at them
        lengths = jnp.asarray(demonstrations.lengths)
    actions = demonstrations.actions
    actions = jnp.zeros((*alive.shape, 0)) if actions is None else jnp.asarray(actions)
    statistics = normalizer.update(normalizer.init(observations.shape[-1]), observations, alive)
    observations = statistics.standardize(observations)
    compared = parse_entries(entries, observations.shape[-1])
    points = jnp.concatenate([observations[..., slice(*compared)], actions], axis=-1)
    stride = demonstrations.stride
    horizon = distance_horizon(points, stride, episode_length)
    if horizon < 1:
        raise UserError(
            f"only every {stride}th step of the demonstrations is kept: episode_length is "
            f"{episode_length}, it must be at least {stride}"
        )
    features = distance_features(jax.random.key(0), points, lengths, horizon, num_distance_samples)
    spread = mean_distance(features, features)
    return Reference(observations, actions, lengths, statistics, features, spread, stride, compared)


def unlike_the_others(reference: Reference, horizon: int, times: float) -> np.ndarray:
    """Tell which demonstrations ``(E,)`` are unlike most, as those of an expert's rare falls are.

    The energy distance of such an episode to all demonstrations, over the first ``horizon`` steps,
    is more than ``times`` the median of these distances. No reward is used.
    """
    features, spread = reference.distance_features, reference.distance_spread
    points = reference.points

    def distance(episode: tuple[jax.Array, jax.Array, jax.Array]) -> jax.Array:
        key, points, lengths = episode
        own = distance_features(key, points[None], lengths[None], horizon, 250)
        return energy_distance(own, features, spread)

    keys = jax.random.split(jax.random.key(1), len(points))
    distances = np.asarray(jax.lax.map(distance, (keys, points, reference.lengths)))
    # Rounding is no difference: where all episodes are the same, none is unlike the others.
    return distances > times * max(float(np.median(distances)), 1e-4 * float(spread))


def distance_horizon(expert_steps: jax.Array, stride: int, episode_length: int) -> int:
    """Return how many of the expert's steps are compared, each with ``stride`` of the policy's.

    Subsampling keeps one step, drawn uniformly, of each block of ``stride`` steps. So subsampled
    episodes are compared at the same times as whole ones, and are alive as often.
    """
    # Nobody knows what the expert would have done after the time limit of the demonstrations.
    return min(episode_length // stride, expert_steps.shape[1])


def distance_features(
    key: jax.Array, points: jax.Array, lengths: jax.Array, horizon: int, num_samples: int
) -> jax.Array:
    """Draw ``(m, d + 1)`` features for the energy distance from ``points (E, T, d)`` of episodes.

    Times are drawn from the first ``horizon`` steps. After its end an episode is in an absorbing
    state, which is zero except for the last entry. That entry puts the state as far from the others
    as they are from one another, so a wrong length of episodes counts as a difference.
    """
    episode_key, time_key = jax.random.split(key)
    episode = jax.random.randint(episode_key, (num_samples,), 0, lengths.shape[0])
    time = jax.random.randint(time_key, (num_samples,), 0, horizon)
    alive = (time < lengths[episode])[:, None]
    drawn = jnp.where(alive, points[episode, time], 0.0)
    absorbed = jnp.where(alive, 0.0, jnp.sqrt(points.shape[-1]))
    return jnp.concatenate([drawn, absorbed], axis=-1)
