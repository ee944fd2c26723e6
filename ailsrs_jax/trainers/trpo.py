"""Trust region policy optimization of a neural policy on the environment's own reward."""

import dataclasses

import jax
import jax.numpy as jnp
from flax import struct

from ailsrs_jax.components import normalizer
from ailsrs_jax.components.policy import KeptPolicy, keep
from ailsrs_jax.envs import Env
from ailsrs_jax.trainers import presets
from ailsrs_jax.trainers.parts.actor_critic import (
    ActorCritic,
    Carry,
    TrustRegionSettings,
    TrustRegionTrainer,
    require_batches,
)
from ailsrs_jax.trainers.parts.episodes import over_updates, with_evaluation
from ailsrs_jax.trainers.parts.rollout import Simulator, as_simulator
from ailsrs_jax.trainers.parts.segments import RunningEnvs
from ailsrs_jax.trainers.parts.settings import validate
from ailsrs_jax.trainers.parts.trainer import Algorithm, Metrics


@dataclasses.dataclass(frozen=True)
class TrpoSettings(TrustRegionSettings):
    """Settings of :class:`Trpo`."""


class TrainState(struct.PyTreeNode):
    """The state that one iteration hands to the next."""

    actor_critic: ActorCritic
    running: RunningEnvs
    kept: KeptPolicy  # best by the return of its evaluation episodes
    key: jax.Array
    iteration: jax.Array  # () int32


@dataclasses.dataclass(frozen=True, eq=False)
class Trpo(TrustRegionTrainer):
    """Trains a neural policy on the environment's reward."""

    simulator: Simulator
    settings: TrpoSettings

    def init(self, key: jax.Array) -> TrainState:
        """Start with a policy that acts almost at random."""
        key, network_key, reset_key = jax.random.split(key, 3)
        actor_critic = self.make_actor_critic(
            network_key, normalizer.init(self.env.observation_size)
        )
        return TrainState(
            actor_critic=actor_critic,
            running=self.begin(reset_key),
            kept=keep(self.policy(actor_critic)),
            key=key,
            iteration=jnp.zeros((), jnp.int32),
        )

    def update(self, state: TrainState) -> tuple[TrainState, Metrics]:
        """Evaluate the policy, then improve it a few times."""
        key, evaluation_key, updates_key = jax.random.split(state.key, 3)
        policy = self.policy(state.actor_critic)
        _, evaluated = self.evaluate(policy, evaluation_key)

        def improve_policy(carry: Carry, key: jax.Array) -> tuple[Carry, Metrics]:
            carry, _, metrics = self.collect_and_improve(
                carry, lambda steps: steps.env_rewards, key
            )
            return carry, metrics

        (actor_critic, running), metrics = jax.lax.scan(
            improve_policy,
            (state.actor_critic, state.running),
            jax.random.split(updates_key, self.settings.updates_per_iteration),
        )
        state = TrainState(
            actor_critic=actor_critic,
            running=running,
            kept=state.kept.offer(policy, evaluated["evaluation_return"], state.iteration),
            key=key,
            iteration=state.iteration + 1,
        )
        return state, with_evaluation(over_updates(metrics), evaluated)


def make_trpo(env: Env | Simulator, settings: TrpoSettings) -> Trpo:
    """Check the settings; see :class:`Trpo`.

    Raises:
        UserError: a setting makes no sense, or the environments cannot share a batch evenly.
    """
    validate(settings)
    require_batches(settings)
    return Trpo(as_simulator(env), settings)


TRPO = Algorithm(
    title="TRPO",
    make=lambda simulator, _, settings: make_trpo(simulator, settings),
    settings=TrpoSettings,
    presets=presets.DEFAULTS,
    imitates=False,
    kept_by="evaluation_return",
)
