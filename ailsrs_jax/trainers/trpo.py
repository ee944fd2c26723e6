"""Trust region policy optimization of a neural policy on the environment's own reward."""

import dataclasses

import jax
import jax.numpy as jnp
from flax import struct

from ailsrs_jax.components import normalizer
from ailsrs_jax.components.policy import KeptPolicy, keep
from ailsrs_jax.envs import Env
from ailsrs_jax.trainers.parts import segments
from ailsrs_jax.trainers.parts.actor_critic import (
    ActorCritic,
    TrustRegionSettings,
    collect_and_improve,
    evaluate,
    gaussian_policy,
    make_actor_critic,
    merge_states,
    over_updates,
    require_batches,
    with_evaluation,
)
from ailsrs_jax.trainers.parts.segments import RunningEnvs
from ailsrs_jax.trainers.parts.settings import validate
from ailsrs_jax.trainers.parts.trainer import Trainer


@dataclasses.dataclass(frozen=True)
class TrpoSettings(TrustRegionSettings):
    """Settings of :class:`Trpo`."""


class TrainState(struct.PyTreeNode):
    """What one iteration hands to the next."""

    actor_critic: ActorCritic
    episodes: RunningEnvs
    kept: KeptPolicy  # best by the return of its evaluation episodes
    key: jax.Array
    iteration: jax.Array  # () int32


@dataclasses.dataclass(frozen=True, eq=False)
class Trpo(Trainer):
    """Trains on the reward of ``env``."""

    env: Env
    settings: TrpoSettings

    def init(self, key: jax.Array) -> TrainState:
        """A policy that does next to nothing but noise."""
        key, network_key, reset_key = jax.random.split(key, 3)
        statistics = normalizer.init(self.env.observation_size)
        actor_critic = make_actor_critic(network_key, self.env, statistics, self.settings)
        return TrainState(
            actor_critic=actor_critic,
            episodes=segments.begin(self.env, reset_key, self.settings.num_envs),
            kept=keep(gaussian_policy(self.env, actor_critic)),
            key=key,
            iteration=jnp.zeros((), jnp.int32),
        )

    def update(self, state: TrainState) -> tuple[TrainState, dict[str, jax.Array]]:
        """Evaluate the policy, then improve it a few times."""
        settings = self.settings
        key, evaluation_key, updates_key = jax.random.split(state.key, 3)
        policy = gaussian_policy(self.env, state.actor_critic)
        _, evaluated = evaluate(self.env, policy, evaluation_key, settings)

        def once(
            carry: tuple[ActorCritic, RunningEnvs], key: jax.Array
        ) -> tuple[tuple[ActorCritic, RunningEnvs], dict[str, jax.Array]]:
            actor_critic, episodes, steps, metrics = collect_and_improve(
                self.env, *carry, lambda steps: steps.env_rewards, key, settings
            )
            return (merge_states(actor_critic, steps), episodes), metrics

        (actor_critic, episodes), metrics = jax.lax.scan(
            once,
            (state.actor_critic, state.episodes),
            jax.random.split(updates_key, settings.updates_per_iteration),
        )
        state = TrainState(
            actor_critic=actor_critic,
            episodes=episodes,
            kept=state.kept.offer(policy, evaluated["evaluation_return"], state.iteration),
            key=key,
            iteration=state.iteration + 1,
        )
        return state, with_evaluation(over_updates(metrics), evaluated)


def make_trpo(env: Env, settings: TrpoSettings) -> Trpo:
    """See :class:`Trpo`.

    Raises:
        UserError: a setting makes no sense, or the batch cannot be shared evenly by the
            environments.
    """
    validate(settings)
    require_batches(settings)
    return Trpo(env, settings)
