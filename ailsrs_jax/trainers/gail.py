"""Generative adversarial imitation learning (Ho and Ermon, NeurIPS 2016), with TRPO."""

import dataclasses
import functools
from typing import Annotated, Literal

import jax
import jax.numpy as jnp
from flax import struct

from ailsrs_jax.components import normalizer
from ailsrs_jax.components.discriminator import LOSSES
from ailsrs_jax.components.policy import KeptPolicy, keep
from ailsrs_jax.data.demonstrations import Demonstrations
from ailsrs_jax.envs import Env
from ailsrs_jax.trainers import presets
from ailsrs_jax.trainers.parts.actor_critic import (
    ActorCritic,
    ActorParameters,
    Carry,
    TrustRegionSettings,
    TrustRegionTrainer,
    require_batches,
)
from ailsrs_jax.trainers.parts.adversary import (
    Adversary,
    AdversarySettings,
    AdversaryState,
    adversary_reference,
)
from ailsrs_jax.trainers.parts.episodes import over_updates, with_evaluation
from ailsrs_jax.trainers.parts.network_clone import clone_network
from ailsrs_jax.trainers.parts.reference import Reference, require_sizes
from ailsrs_jax.trainers.parts.rollout import Simulator, as_simulator
from ailsrs_jax.trainers.parts.segments import RunningEnvs, Steps
from ailsrs_jax.trainers.parts.settings import Positive, validate
from ailsrs_jax.trainers.parts.trainer import Algorithm, Metrics

CLONING_RATE = 3e-4


@dataclasses.dataclass(frozen=True)
class GailSettings(TrustRegionSettings, AdversarySettings):
    """Settings of :class:`Gail`; the defaults are those of OpenAI Baselines."""

    policy_steps: int = 3  #: of the policy for each of the discriminator
    discriminator_loss: Annotated[str, LOSSES] = "cross_entropy"
    discriminator_learning_rate: Positive = 3e-4
    discriminator_steps: int = 1
    discriminator_batch_size: int = 1024
    discriminator_entropy_bonus: float = 1e-3
    behavior_cloning_start: bool = False
    behavior_cloning_steps: int = 10_000  #: of Adam
    standardize_with: Literal["running", "expert"] = "running"  #: whose statistics
    num_distance_samples: int = 1500  #: from each side, for the choice of the policy to keep

    @property
    def policy_updates(self) -> int:
        """Batches of steps that an iteration collects."""
        return self.updates_per_iteration * self.policy_steps


class TrainState(struct.PyTreeNode):
    """The state that one iteration hands to the next."""

    actor_critic: ActorCritic
    running: RunningEnvs
    adversary: AdversaryState
    kept: KeptPolicy  # closest to the expert so far, by energy distance
    key: jax.Array
    iteration: jax.Array  # () int32


Turn = tuple[ActorCritic, RunningEnvs, AdversaryState]


@dataclasses.dataclass(frozen=True, eq=False)
class Gail(TrustRegionTrainer):
    """Imitates ``reference`` in an environment; its reward is measured but never used.

    Policy and value function are neural. The discriminator is that of
    :class:`~ailsrs_jax.trainers.ailsrs.Ailsrs`.
    """

    simulator: Simulator
    settings: GailSettings
    reference: Reference

    def init(self, key: jax.Array) -> TrainState:
        """Start with a policy that acts almost at random, or with a clone of the expert."""
        settings = self.settings
        key, network_key, reset_key, adversary_key, cloning_key = jax.random.split(key, 5)
        statistics = normalizer.init(self.env.observation_size)
        if settings.standardize_with == "expert" or settings.behavior_cloning_start:
            statistics = self.reference.statistics
        actor_critic = self.make_actor_critic(network_key, statistics)
        if settings.behavior_cloning_start:
            cloned = clone_network(
                actor_critic.actor.layers,
                actor_critic.actor.log_std,
                self.reference,
                cloning_key,
                num_steps=settings.behavior_cloning_steps,
                learning_rate=CLONING_RATE,
            )
            actor_critic = actor_critic.replace(actor=ActorParameters(*cloned))
        return TrainState(
            actor_critic=actor_critic,
            running=self.begin(reset_key),
            adversary=self.adversary.init(adversary_key),
            kept=keep(self.policy(actor_critic)),
            key=key,
            iteration=jnp.zeros((), jnp.int32),
        )

    def update(self, state: TrainState) -> tuple[TrainState, Metrics]:
        """Evaluate the policy, then improve policy and discriminator in turns."""
        settings = self.settings
        key, evaluation_key, updates_key, distance_key = jax.random.split(state.key, 4)
        policy = self.policy(state.actor_critic)
        evaluation, evaluated = self.evaluate(policy, evaluation_key)
        distance = self.reference.distance(distance_key, evaluation, settings.episode_length)
        evaluated["expert_distance"] = distance
        done = jnp.minimum(state.iteration / max(settings.num_iterations - 1, 1), 1.0)
        (actor_critic, running, adversary), metrics = jax.lax.scan(
            functools.partial(self._take_turns, done),
            (state.actor_critic, state.running, state.adversary),
            jax.random.split(updates_key, settings.updates_per_iteration),
        )
        state = TrainState(
            actor_critic=actor_critic,
            running=running,
            adversary=adversary,
            kept=state.kept.offer(policy, -distance, state.iteration),
            key=key,
            iteration=state.iteration + 1,
        )
        return state, with_evaluation(over_updates(metrics), evaluated)

    @property
    def adversary(self) -> Adversary:
        """The discriminator's functions; its parameters are part of the state."""
        return Adversary(self.settings, self.reference)

    def _take_turns(self, done: jax.Array, carry: Turn, key: jax.Array) -> tuple[Turn, Metrics]:
        """Take some steps of the policy, then the discriminator's on the last of their batches.

        ``done`` is the part of the iterations that is done, from 0 to 1.
        """
        actor_critic, running, adversary = carry
        policy_key, adversary_key = jax.random.split(key)

        def rewards(steps: Steps) -> jax.Array:
            return self.adversary.rewards(adversary, self._inputs(steps))

        def improve_policy(carry: Carry, key: jax.Array) -> tuple[Carry, tuple[Metrics, jax.Array]]:
            carry, steps, metrics = self.collect_and_improve(
                carry, rewards, key, merges_states=self.settings.standardize_with == "running"
            )
            metrics["imitation_reward"] = rewards(steps).mean()
            return carry, (metrics, self._inputs(steps))

        (actor_critic, running), (metrics, inputs) = jax.lax.scan(
            improve_policy,
            (actor_critic, running),
            jax.random.split(policy_key, self.settings.policy_steps),
        )
        latest = inputs[-1].reshape(-1, inputs.shape[-1])
        adversary, scores = self.adversary.train(
            adversary,
            adversary_key,
            lambda key, size: jax.random.choice(key, latest, (size,)),
            done,
        )
        return (actor_critic, running, adversary), over_updates(metrics) | scores

    def _inputs(self, steps: Steps) -> jax.Array:
        """Return discriminator inputs ``(T, S, d)``."""
        return self.adversary.inputs(steps.observations, steps.actions, steps.next_observations)


def make_gail(env: Env | Simulator, demonstrations: Demonstrations, settings: GailSettings) -> Gail:
    """Prepare the demonstrations for training in ``env``; see :class:`Gail`.

    Raises:
        UserError: a setting makes no sense, the environments cannot share a batch evenly, or the
            demonstrations do not fit the environment or lack what the settings need.
    """
    validate(settings)
    require_batches(settings)
    simulator = as_simulator(env)
    require_sizes(demonstrations, simulator.env)
    return Gail(simulator, settings, adversary_reference(demonstrations, settings))


GAIL = Algorithm("GAIL", make_gail, GailSettings, presets.GAIL)
