"""A Gaussian policy and a value function, improved together from steps and their rewards."""

import dataclasses
import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax
from flax import struct

from ailsrs_jax.components import normalizer, trust_region
from ailsrs_jax.components.descent import descend
from ailsrs_jax.components.normalizer import RunningStatistics
from ailsrs_jax.components.policy import Layers, MlpPolicy, perceptron, repeated
from ailsrs_jax.envs.interface import action_range
from ailsrs_jax.errors import UserError
from ailsrs_jax.trainers.parts.episodes import Episodes
from ailsrs_jax.trainers.parts.network_clone import draw_layers
from ailsrs_jax.trainers.parts.segments import RunningEnvs, Steps, begin, collect
from ailsrs_jax.trainers.parts.settings import Positive, UpToOne, require_countable
from ailsrs_jax.trainers.parts.trainer import Metrics, Trainer

HIDDEN_SIZES = (100, 100)  # tanh units of policy and value function
FISHER_STRIDE = 5  # the curvature is estimated from every fifth step, the gradient from all


@dataclasses.dataclass(frozen=True)
class TrustRegionSettings:
    """Settings of :class:`ActorCritic`; the defaults are those of OpenAI Baselines' GAIL."""

    num_iterations: int = 160
    updates_per_iteration: int = 10  #: between two evaluations
    num_envs: int = 8
    batch_size: int = 1024  #: steps of all environments together, for one step of the policy
    episode_length: int = 1000
    discount: UpToOne = 0.995
    advantage_decay: UpToOne = 0.97  #: λ
    max_divergence: Positive = 0.01  #: in nats, of a step of the policy
    conjugate_gradient_steps: int = 10
    conjugate_gradient_damping: float = 0.1
    num_backtracks: int = 10
    value_learning_rate: Positive = 1e-3
    value_epochs: int = 5
    value_batch_size: int = 128
    num_evaluation_episodes: int = 4

    @property
    def policy_updates(self) -> int:
        """Batches of steps that an iteration collects."""
        return self.updates_per_iteration

    @property
    def steps_per_iteration(self) -> int:
        """Environment steps that an iteration simulates at most."""
        num_episodes = 2 * self.num_evaluation_episodes  # of the mean, and with drawn actions
        return self.policy_updates * self.batch_size + num_episodes * self.episode_length


def require_batches(settings: TrustRegionSettings) -> None:
    """Raise UserError unless the environments can share a batch evenly, and steps be counted."""
    require_countable(settings.steps_per_iteration)
    if settings.batch_size % settings.num_envs:
        raise UserError(
            f"setting batch_size is {settings.batch_size}: it must be a multiple of num_envs, "
            f"{settings.num_envs}"
        )


class ActorParameters(struct.PyTreeNode):
    """The part of the policy that a step changes."""

    layers: Layers
    log_std: jax.Array  # (p,)


class ActorCritic(struct.PyTreeNode):
    """A policy and its value function."""

    actor: ActorParameters
    critic: Layers
    critic_optimizer: optax.OptState
    statistics: RunningStatistics  # observations are standardised with them


Carry = tuple[ActorCritic, RunningEnvs]  # from one batch of steps to the next


class TrustRegionTrainer(Trainer):
    """Improves a Gaussian policy in trust regions, from batches of steps and their rewards."""

    settings: TrustRegionSettings

    def begin(self, key: jax.Array) -> RunningEnvs:
        """Start the environments whose steps are collected."""
        return begin(self.env, key, self.settings.num_envs, self.settings.episode_length)

    def make_actor_critic(self, key: jax.Array, statistics: RunningStatistics) -> ActorCritic:
        """Make a policy with a mean near zero everywhere and a standard deviation of one."""
        actor_key, critic_key = jax.random.split(key)
        hidden = self.env.observation_size, *HIDDEN_SIZES
        critic = draw_layers(critic_key, (*hidden, 1))
        return ActorCritic(
            actor=ActorParameters(
                layers=draw_layers(actor_key, (*hidden, self.env.action_size), final_scale=0.01),
                log_std=jnp.zeros(self.env.action_size),
            ),
            critic=critic,
            critic_optimizer=self._critic_adam.init(critic),
            statistics=statistics,
        )

    def policy(self, state: ActorCritic) -> MlpPolicy:
        """Return the policy, with the statistics frozen as they are."""
        mean, std = state.statistics.mean, state.statistics.std
        action_std = jnp.exp(state.actor.log_std)
        return MlpPolicy(*state.actor.layers, mean, std, *action_range(self.env), action_std)

    def evaluate(self, policy: MlpPolicy, key: jax.Array) -> tuple[Episodes, Metrics]:
        """Return episodes of the Gaussian's mean; the metrics include some with drawn actions."""
        settings, num_episodes = self.settings, self.settings.num_evaluation_episodes
        noise_key, reset_key = jax.random.split(key)
        shape = (num_episodes, settings.episode_length, self.env.action_size)
        noise = policy.action_std * jax.random.normal(noise_key, shape)
        episodes = self.simulator(
            repeated(policy, 2 * num_episodes),
            jax.random.split(reset_key, 2 * num_episodes),
            settings.episode_length,
            noise=jnp.concatenate([jnp.zeros(shape), noise]),
        )
        mean = episodes.first(num_episodes)
        return mean, mean.evaluated() | {
            "stochastic_return": episodes.env_rewards[num_episodes:].sum(axis=1).mean(),
            "action_std": policy.action_std.mean(),
            **episodes.counts(),
        }

    def collect_and_improve(
        self,
        carry: Carry,
        rewards: Callable[[Steps], jax.Array],
        key: jax.Array,
        *,
        merges_states: bool = True,
    ) -> tuple[Carry, Steps, Metrics]:
        """Collect steps, improve the policy by their ``rewards (T, S)``, then the value function.

        ``merges_states`` says whether observations are standardised with those of the steps, too.
        """
        settings = self.settings
        state, running = carry
        collect_key, critic_key = jax.random.split(key)
        running, steps = collect(
            self.env,
            self.policy(state),
            running,
            collect_key,
            settings.batch_size // settings.num_envs,
            settings.episode_length,
        )
        state, metrics = self._improve(state, steps, rewards(steps), critic_key)
        if merges_states:
            statistics = normalizer.update(state.statistics, steps.observations, ~steps.copied)
            state = state.replace(statistics=statistics)
        return (state, running), steps, metrics | steps.counts()

    def _improve(
        self, state: ActorCritic, steps: Steps, rewards: jax.Array, key: jax.Array
    ) -> tuple[ActorCritic, Metrics]:
        observations, next_observations = map(
            state.statistics.standardize, (steps.observations, steps.next_observations)
        )
        values, next_values = (_values(state.critic, x) for x in (observations, next_observations))
        advantages = trust_region.generalized_advantages(
            rewards,
            values,
            next_values,
            steps.terminated,
            steps.over,
            discount=self.settings.discount,
            decay=self.settings.advantage_decay,
        )
        targets = advantages + values
        observations, actions, advantages, targets = jax.tree.map(
            lambda x: x.reshape(-1, *x.shape[2:]),
            (observations, steps.drawn_actions, advantages, targets),
        )
        actor, metrics = self._improve_actor(state.actor, observations, actions, advantages)
        critic, optimizer, value_loss = self._fit_critic(state, observations, targets, key)
        improved = ActorCritic(actor, critic, optimizer, state.statistics)
        return improved, metrics | {"value_loss": value_loss}

    def _improve_actor(
        self,
        actor: ActorParameters,
        observations: jax.Array,
        actions: jax.Array,
        advantages: jax.Array,
    ) -> tuple[ActorParameters, Metrics]:
        advantages = (advantages - advantages.mean()) / jnp.maximum(advantages.std(), 1e-8)
        means = perceptron(*actor.layers, observations)
        log_density = trust_region.gaussian_log_density(actions, means, actor.log_std)

        def gain(candidate: ActorParameters) -> jax.Array:
            means = perceptron(*candidate.layers, observations)
            candidates = trust_region.gaussian_log_density(actions, means, candidate.log_std)
            return jnp.mean(jnp.exp(candidates - log_density) * advantages)

        def divergence(candidate: ActorParameters, rows: Any = slice(None)) -> jax.Array:
            candidate_means = perceptron(*candidate.layers, observations[rows])
            return trust_region.gaussian_divergence(
                means[rows], actor.log_std, candidate_means, candidate.log_std
            ).mean()

        time = np.arange(len(means)) // self.settings.num_envs  # so that all environments count
        every_fifth = np.flatnonzero(time % FISHER_STRIDE == 0)

        return trust_region.trust_region_step(
            actor,
            gain,
            divergence,
            functools.partial(divergence, rows=every_fifth),
            max_divergence=self.settings.max_divergence,
            iterations=self.settings.conjugate_gradient_steps,
            damping=self.settings.conjugate_gradient_damping,
            num_backtracks=self.settings.num_backtracks,
        )

    def _fit_critic(
        self, state: ActorCritic, observations: jax.Array, targets: jax.Array, key: jax.Array
    ) -> tuple[Layers, optax.OptState, jax.Array]:
        """Run Adam on the squared error; an incomplete minibatch of an epoch is left out."""
        size = min(self.settings.value_batch_size, len(targets))

        def loss(critic: Layers, indices: jax.Array) -> tuple[jax.Array, jax.Array]:
            error = jnp.mean(jnp.square(_values(critic, observations[indices]) - targets[indices]))
            return error, error

        orders = jax.vmap(lambda key: jax.random.permutation(key, len(targets)))(
            jax.random.split(key, self.settings.value_epochs)
        )
        batches = orders[:, : len(targets) // size * size].reshape(-1, size)
        critic, optimizer, losses = descend(
            self._critic_adam, loss, state.critic, state.critic_optimizer, batches
        )
        return critic, optimizer, losses.mean()

    @property
    def _critic_adam(self) -> optax.GradientTransformation:
        return optax.adam(self.settings.value_learning_rate)


def _values(critic: Layers, observations: jax.Array) -> jax.Array:
    return perceptron(*critic, observations).squeeze(-1)
