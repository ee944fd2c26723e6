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
from ailsrs_jax.trainers.parts.devices import EVERYWHERE, ONE_DEVICE, Devices
from ailsrs_jax.trainers.parts.exploration import count_episodes, explore
from ailsrs_jax.trainers.parts.settings import Positive, Signed, require_countable, validate
from ailsrs_jax.trainers.parts.trainer import Trainer


@dataclasses.dataclass(frozen=True)
class ArsSettings:
    """Settings of :class:`Ars`; the defaults are ARS V2-t as in its paper's HalfCheetah."""

    num_iterations: int = 300
    num_directions: int = 32
    num_top_directions: int = 4
    step_size: Positive = 0.02
    noise_std: Positive = 0.03
    episode_length: int = 1000
    scale_by_std: bool = True  #: False is BRS
    normalize_observations: bool = True  #: False is BRS and V1
    survival_bonus: Signed = 0.0  #: subtracted from the reward of every step
    num_evaluation_episodes: int = 8


class TrainState(struct.PyTreeNode):
    """What one iteration hands to the next."""

    weights: jax.Array  # (p, n)
    statistics: RunningStatistics  # of all states met
    kept: KeptPolicy  # best by the return of its evaluation episodes
    key: jax.Array
    iteration: jax.Array  # () int32


@dataclasses.dataclass(frozen=True, eq=False)
class Ars(Trainer):
    """Random search of a linear policy on the reward of ``env``.

    ``devices`` and ``rollout_batch_size`` are as in :class:`~ailsrs_jax.trainers.ailsrs.Ailsrs`.
    """

    env: Env
    settings: ArsSettings
    devices: Devices = ONE_DEVICE
    rollout_batch_size: int | None = None

    def init(self, key: jax.Array) -> TrainState:
        """The paper's start: all weights zero, no statistics."""
        return self.devices.split(self._init, EVERYWHERE, EVERYWHERE)(key)

    def _init(self, key: jax.Array) -> TrainState:
        weights = jnp.zeros((self.env.action_size, self.env.observation_size))
        statistics = normalizer.init(self.env.observation_size)
        return TrainState(
            weights=weights,
            statistics=statistics,
            kept=keep(self.policy(weights, statistics)),
            key=key,
            iteration=jnp.zeros((), jnp.int32),
        )

    def update(self, state: TrainState) -> tuple[TrainState, dict[str, jax.Array]]:
        """One iteration: perturb, roll out, step; then merge the states met."""
        return self.devices.split(self._update, EVERYWHERE, EVERYWHERE)(state)

    def policy(self, weights: jax.Array, statistics: RunningStatistics) -> LinearPolicy:
        """The unperturbed policy, with statistics frozen as they are."""
        low, high = action_range(self.env)
        if not self.settings.normalize_observations:
            statistics = normalizer.init(self.env.observation_size)
        return LinearPolicy(weights, statistics.mean, statistics.std, low, high)

    def _update(self, state: TrainState) -> tuple[TrainState, dict[str, jax.Array]]:
        """:meth:`update` on one device."""
        settings, devices = self.settings, self.devices
        key, noise_key, reset_key = jax.random.split(state.key, 3)

        policy = self.policy(state.weights, state.statistics)
        deltas = random_search.sample_directions(
            noise_key, settings.num_directions, state.weights.shape
        )
        num_evaluations = settings.num_evaluation_episodes
        batch = explore(
            self.env,
            policy,
            deltas,
            reset_key,
            noise_std=settings.noise_std,
            num_evaluation_episodes=num_evaluations,
            episode_length=settings.episode_length,
            devices=devices,
            batch_size=self.rollout_batch_size,
        )

        returns = batch.env_returns - settings.survival_bonus * batch.lengths
        returns = returns[num_evaluations:].reshape(2, -1)
        returns_plus, returns_minus = devices.gather(returns, axis=1)
        weights = random_search.step(
            state.weights,
            deltas,
            returns_plus,
            returns_minus,
            step_size=settings.step_size,
            num_top_directions=settings.num_top_directions,
            scale_by_std=settings.scale_by_std,
        )
        evaluation = batch.episodes(0, num_evaluations)
        # Beside other episodes on each device, which can change the last bits.
        evaluation_return, evaluation_length = devices.agree(
            (evaluation.env_returns.mean(), evaluation.lengths.mean())
        )
        metrics = {
            "evaluation_return": evaluation_return,
            "evaluation_length": evaluation_length,
            **count_episodes(batch, num_evaluations, devices),
        }
        state = TrainState(
            weights=weights,
            statistics=normalizer.update(
                state.statistics,
                batch.observations,
                batch.alive_from(num_evaluations),
                devices.sum,
            ),
            kept=state.kept.offer(policy, evaluation_return, state.iteration),
            key=key,
            iteration=state.iteration + 1,
        )
        return state, metrics


def make_ars(
    env: Env,
    settings: ArsSettings,
    devices: Devices = ONE_DEVICE,
    rollout_batch_size: int | None = None,
) -> Ars:
    """See :class:`Ars`.

    Raises:
        UserError: a setting makes no sense, the directions cannot be shared evenly, or there are
            too many steps to count.
    """
    validate(settings)
    num_episodes = 2 * settings.num_directions + settings.num_evaluation_episodes
    require_countable(num_episodes * settings.episode_length)
    devices.require_share(settings.num_directions)
    return Ars(env, settings, devices, rollout_batch_size)
