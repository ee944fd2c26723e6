"""Generative adversarial imitation learning (Ho and Ermon, NeurIPS 2016), with TRPO."""

import dataclasses
from typing import Literal

import jax
import jax.numpy as jnp
import optax
from flax import struct

from ailsrs_jax.components import normalizer, trust_region
from ailsrs_jax.components.finite import finite_or
from ailsrs_jax.components.policy import KeptPolicy, keep, perceptron
from ailsrs_jax.components.sampling import sample_steps
from ailsrs_jax.data.demonstrations import Demonstrations
from ailsrs_jax.envs import Env
from ailsrs_jax.trainers.parts import segments
from ailsrs_jax.trainers.parts.actor_critic import (
    ActorCritic,
    ActorParameters,
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
from ailsrs_jax.trainers.parts.adversary import Adversary, AdversarySettings, AdversaryState
from ailsrs_jax.trainers.parts.reference import Reference, make_reference
from ailsrs_jax.trainers.parts.segments import RunningEnvs, Steps
from ailsrs_jax.trainers.parts.settings import Positive, validate
from ailsrs_jax.trainers.parts.trainer import Trainer

CLONING_BATCH_SIZE = 128
CLONING_LEARNING_RATE = 3e-4


@dataclasses.dataclass(frozen=True)
class GailSettings(TrustRegionSettings, AdversarySettings):
    """Settings of :class:`Gail`; the defaults are those of OpenAI Baselines."""

    policy_steps: int = 3  #: of the policy for each of the discriminator
    discriminator_loss: Literal["least_squares", "cross_entropy"] = "cross_entropy"
    discriminator_learning_rate: Positive = 3e-4
    discriminator_steps: int = 1
    discriminator_batch_size: int = 1024
    discriminator_entropy_bonus: float = 1e-3
    behavior_cloning_start: bool = False
    behavior_cloning_steps: int = 10_000  #: of Adam
    standardize_with: Literal["running", "expert"] = "running"  #: whose statistics
    num_distance_samples: int = 1500  #: from each side, for the choice of the policy to keep


class TrainState(struct.PyTreeNode):
    """What one iteration hands to the next."""

    actor_critic: ActorCritic
    episodes: RunningEnvs
    adversary: AdversaryState
    kept: KeptPolicy  # closest to the expert so far, by energy distance
    key: jax.Array
    iteration: jax.Array  # () int32


@dataclasses.dataclass(frozen=True, eq=False)
class Gail(Trainer):
    """Imitates ``expert`` in ``env``, whose reward is measured but never used.

    Policy and value function are neural; the discriminator is that of
    :class:`~ailsrs_jax.trainers.ailsrs.Ailsrs`.
    """

    env: Env
    settings: GailSettings
    reference: Reference

    def init(self, key: jax.Array) -> TrainState:
        """A policy that does next to nothing but noise; or one cloned from the expert."""
        settings = self.settings
        key, network_key, reset_key, adversary_key, cloning_key = jax.random.split(key, 5)
        statistics = normalizer.init(self.env.observation_size)
        if settings.standardize_with == "expert" or settings.behavior_cloning_start:
            statistics = self.reference.statistics
        actor_critic = make_actor_critic(network_key, self.env, statistics, settings)
        if settings.behavior_cloning_start:
            actor = clone(actor_critic.actor, self.reference, cloning_key, settings)
            actor_critic = actor_critic.replace(actor=actor)
        return TrainState(
            actor_critic=actor_critic,
            episodes=segments.begin(self.env, reset_key, settings.num_envs),
            adversary=self._adversary.init(adversary_key),
            kept=keep(gaussian_policy(self.env, actor_critic)),
            key=key,
            iteration=jnp.zeros((), jnp.int32),
        )

    def update(self, state: TrainState) -> tuple[TrainState, dict[str, jax.Array]]:
        """Evaluate the policy, then improve policy and discriminator a few times in turns."""
        settings = self.settings
        keys = jax.random.split(state.key, 4)
        key, evaluation_key, updates_key, distance_key = keys
        policy = gaussian_policy(self.env, state.actor_critic)
        evaluation, evaluated = evaluate(self.env, policy, evaluation_key, settings)
        evaluated["expert_distance"] = self.reference.distance(
            distance_key, evaluation, settings.episode_length
        )
        (actor_critic, episodes, adversary), metrics = jax.lax.scan(
            self._take_turns,
            (state.actor_critic, state.episodes, state.adversary),
            jax.random.split(updates_key, settings.updates_per_iteration),
        )
        state = TrainState(
            actor_critic=actor_critic,
            episodes=episodes,
            adversary=adversary,
            kept=state.kept.offer(policy, -evaluated["expert_distance"], state.iteration),
            key=key,
            iteration=state.iteration + 1,
        )
        return state, with_evaluation(over_updates(metrics), evaluated)

    @property
    def _adversary(self) -> Adversary:
        return Adversary(self.settings, self.reference)

    def _take_turns(
        self, carry: tuple[ActorCritic, RunningEnvs, AdversaryState], key: jax.Array
    ) -> tuple[tuple[ActorCritic, RunningEnvs, AdversaryState], dict[str, jax.Array]]:
        """Some steps of the policy, then the discriminator's on the last of their batches."""
        actor_critic, episodes, adversary = carry
        policy_key, adversary_key = jax.random.split(key)

        def improve_policy(
            carry: tuple[ActorCritic, RunningEnvs], key: jax.Array
        ) -> tuple[tuple[ActorCritic, RunningEnvs], tuple[dict[str, jax.Array], jax.Array]]:
            actor_critic, episodes, steps, metrics = collect_and_improve(
                self.env, *carry, rewards, key, self.settings
            )
            if self.settings.standardize_with == "running":
                actor_critic = merge_states(actor_critic, steps)
            metrics = metrics | {"imitation_reward": rewards(steps).mean()}
            return (actor_critic, episodes), (metrics, self._inputs(steps))

        def rewards(steps: Steps) -> jax.Array:
            return self._adversary.rewards(adversary, self._inputs(steps))

        (actor_critic, episodes), (metrics, inputs) = jax.lax.scan(
            improve_policy,
            (actor_critic, episodes),
            jax.random.split(policy_key, self.settings.policy_steps),
        )
        latest = inputs[-1].reshape(-1, inputs.shape[-1])

        def sample(key: jax.Array, size: int) -> tuple[jax.Array, jax.Array]:
            return jax.random.choice(key, latest, (size,)), jnp.ones(size, bool)

        adversary, adversary_metrics = self._adversary.train(adversary, adversary_key, sample)
        metrics = over_updates(metrics) | adversary_metrics
        return (actor_critic, episodes, adversary), metrics

    def _inputs(self, steps: Steps) -> jax.Array:
        """``(T, S, d)`` discriminator inputs."""
        return self._adversary.inputs(steps.observations, steps.actions, steps.next_observations)


def clone(
    actor: ActorParameters, expert: Reference, key: jax.Array, settings: GailSettings
) -> ActorParameters:
    """Behaviour cloning: make the expert's actions the likeliest.

    Of the likelihood, not the squared error, because that leaves the standard deviation at what
    the mean misses by; at one, the noise would throw away what was cloned.
    """
    adam = optax.adam(CLONING_LEARNING_RATE)

    def loss(actor: ActorParameters, key: jax.Array) -> jax.Array:
        episode, time = sample_steps(key, expert.lengths, CLONING_BATCH_SIZE)
        means = perceptron(*actor.layers, expert.observations[episode, time])
        actions = expert.actions[episode, time]
        return -trust_region.gaussian_log_density(actions, means, actor.log_std).mean()

    def adam_step(
        carry: tuple[ActorParameters, optax.OptState], key: jax.Array
    ) -> tuple[tuple[ActorParameters, optax.OptState], None]:
        actor, optimizer = carry
        updates, optimizer = adam.update(jax.grad(loss)(actor, key), optimizer, actor)
        return (optax.apply_updates(actor, updates), optimizer), None

    keys = jax.random.split(key, settings.behavior_cloning_steps)
    (cloned, _), _ = jax.lax.scan(adam_step, (actor, adam.init(actor)), keys)
    return finite_or(cloned, actor)


def make_gail(env: Env, demonstrations: Demonstrations, settings: GailSettings) -> Gail:
    """Prepare the demonstrations for training in ``env``; see :class:`Gail`.

    Raises:
        UserError: a setting makes no sense, the batch cannot be shared evenly by the environments,
            or the demonstrations do not hold what the settings need.
    """
    validate(settings)
    require_batches(settings, settings.policy_steps)
    expert = make_reference(demonstrations, settings.episode_length, settings.num_distance_samples)
    Adversary(settings, expert)  # checks that the demonstrations hold what it sees
    if settings.behavior_cloning_start:
        expert.require_actions("behavior_cloning_start")
    return Gail(env, settings, expert)
