"""Augmented and basic random search on the environment's own reward.

Mania, Guy and Recht, "Simple random search of static linear policies is competitive for
reinforcement learning", NeurIPS 2018.
"""

import dataclasses

import jax
import jax.numpy as jnp
from flax import struct

from ailsrs_jax.components import normalizer, random_search
from ailsrs_jax.components.normalizer import RunningStatistics
from ailsrs_jax.components.policy import KeptPolicy, LinearPolicy, keep
from ailsrs_jax.envs import Env
from ailsrs_jax.envs.interface import action_range
from ailsrs_jax.trainers import presets
from ailsrs_jax.trainers.parts.episodes import with_evaluation
from ailsrs_jax.trainers.parts.rollout import Simulator, as_simulator
from ailsrs_jax.trainers.parts.settings import (
    FromZero,
    Positive,
    Signed,
    require_countable,
    validate,
)
from ailsrs_jax.trainers.parts.trainer import Algorithm, Metrics, Trainer


@dataclasses.dataclass(frozen=True)
class ArsSettings:
    """Settings of :class:`Ars`; the defaults are ARS V2-t as in its paper's HalfCheetah."""

    num_iterations: int = 300
    num_directions: int = 32
    num_top_directions: FromZero = 4  #: 0: all, as in BRS
    step_size: Positive = 0.02
    noise_std: Positive = 0.03
    episode_length: int = 1000
    scale_by_std: bool = True  #: False in BRS
    normalize_observations: bool = True  #: False in BRS and V1
    survival_bonus: Signed = 0.0  #: subtracted from the reward of every step
    num_evaluation_episodes: int = 8

    @property
    def steps_per_iteration(self) -> int:
        """Environment steps that an iteration simulates at most."""
        return (2 * self.num_directions + self.num_evaluation_episodes) * self.episode_length


class TrainState(struct.PyTreeNode):
    """The state that one iteration hands to the next."""

    weights: jax.Array  # (p, n)
    statistics: RunningStatistics  # of all observations
    kept: KeptPolicy  # best by the return of its evaluation episodes
    key: jax.Array
    iteration: jax.Array  # () int32


@dataclasses.dataclass(frozen=True, eq=False)
class Ars(Trainer):
    """Random search of a linear policy on the environment's reward."""

    simulator: Simulator
    settings: ArsSettings

    def init(self, key: jax.Array) -> TrainState:
        """Start with weights of zero and no statistics, as the paper does."""
        weights = jnp.zeros((self.env.action_size, self.env.observation_size))
        statistics = normalizer.init(self.env.observation_size)
        return TrainState(
            weights=weights,
            statistics=statistics,
            kept=keep(self.policy(weights, statistics)),
            key=key,
            iteration=jnp.zeros((), jnp.int32),
        )

    def update(self, state: TrainState) -> tuple[TrainState, Metrics]:
        """Run one iteration: perturb, simulate, step; then merge the observations."""
        settings = self.settings
        key, noise_key, reset_key, evaluation_key = jax.random.split(state.key, 4)
        policy = self.policy(state.weights, state.statistics)
        deltas = jax.random.normal(noise_key, (settings.num_directions, *state.weights.shape))
        episodes = self.simulator(
            policy.with_weights(random_search.perturb(state.weights, deltas, settings.noise_std)),
            jax.random.split(reset_key, 2 * settings.num_directions),
            settings.episode_length,
        )
        _, evaluated = self.evaluate(policy, evaluation_key)
        returns = episodes.env_returns - settings.survival_bonus * episodes.lengths
        weights = random_search.step(
            state.weights,
            deltas,
            *returns.reshape(2, -1),
            step_size=settings.step_size,
            num_top_directions=settings.num_top_directions,
            scale_by_std=settings.scale_by_std,
        )
        state = TrainState(
            weights=weights,
            statistics=normalizer.update(state.statistics, episodes.observations, episodes.usable),
            kept=state.kept.offer(policy, evaluated["evaluation_return"], state.iteration),
            key=key,
            iteration=state.iteration + 1,
        )
        return state, with_evaluation(episodes.counts(), evaluated)

    def policy(self, weights: jax.Array, statistics: RunningStatistics) -> LinearPolicy:
        """Return the unperturbed policy, with the statistics frozen as they are."""
        if not self.settings.normalize_observations:
            statistics = normalizer.init(self.env.observation_size)
        return LinearPolicy(weights, statistics.mean, statistics.std, *action_range(self.env))


def make_ars(env: Env | Simulator, settings: ArsSettings) -> Ars:
    """Check the settings; see :class:`Ars`.

    Raises:
        UserError: a setting makes no sense, or there are too many steps to count.
    """
    validate(settings)
    require_countable(settings.steps_per_iteration)
    return Ars(as_simulator(env), settings)


ARS = Algorithm(
    title="ARS",
    make=lambda simulator, _, settings: make_ars(simulator, settings),
    settings=ArsSettings,
    presets=presets.ARS,
    imitates=False,
    shares_devices=True,
    kept_by="evaluation_return",
)


def _basic(changes: presets.Changes) -> presets.Changes:
    """Turn changes of ARS's settings into those of BRS: all directions, no scaling, no statistics.

    A step of BRS is proportional to the returns, which are about a hundred apart; ARS divides by
    their standard deviation. So the step size is a hundredth.
    """
    settings = dataclasses.replace(ArsSettings(), **changes)
    return {
        **changes,
        "num_top_directions": 0,
        "step_size": settings.step_size / 100.0,
        "scale_by_std": False,
        "normalize_observations": False,
    }


BRS = dataclasses.replace(
    ARS,
    title="BRS",
    presets={
        preset: {task: _basic(changes) for task, changes in tasks.items()}
        for preset, tasks in presets.ARS.items()
    },
)
