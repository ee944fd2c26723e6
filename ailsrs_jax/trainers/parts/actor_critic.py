"""A Gaussian policy and a value function, improved together from steps and their rewards."""

import dataclasses
from collections.abc import Callable

import jax
import jax.numpy as jnp
import optax
from flax import struct

from ailsrs_jax.components import normalizer, trust_region
from ailsrs_jax.components.descent import descend
from ailsrs_jax.components.network_clone import draw_layers
from ailsrs_jax.components.normalizer import RunningStatistics
from ailsrs_jax.components.policy import Layers, MlpPolicy, perceptron, repeated
from ailsrs_jax.envs import Env
from ailsrs_jax.envs.interface import action_range
from ailsrs_jax.errors import UserError
from ailsrs_jax.trainers.parts.episodes import Episodes
from ailsrs_jax.trainers.parts.rollout import Simulator
from ailsrs_jax.trainers.parts.segments import RunningEnvs, Steps, collect
from ailsrs_jax.trainers.parts.settings import Positive, UpToOne, require_countable

HIDDEN_SIZES = (100, 100)  # tanh units of policy and value function
FISHER_STRIDE = 5  # the curvature is estimated from every fifth sample, the gradient from all


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


Metrics = dict[str, jax.Array]


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


def make_actor_critic(
    key: jax.Array, env: Env, statistics: RunningStatistics, settings: TrustRegionSettings
) -> ActorCritic:
    """Make a policy with a mean near zero everywhere and a standard deviation of one."""
    actor_key, critic_key = jax.random.split(key)
    hidden = env.observation_size, *HIDDEN_SIZES
    critic = draw_layers(critic_key, (*hidden, 1))
    return ActorCritic(
        actor=ActorParameters(
            layers=draw_layers(actor_key, (*hidden, env.action_size), final_scale=0.01),
            log_std=jnp.zeros(env.action_size),
        ),
        critic=critic,
        critic_optimizer=_critic_adam(settings).init(critic),
        statistics=statistics,
    )


def gaussian_policy(env: Env, state: ActorCritic) -> MlpPolicy:
    """Return the policy, with the statistics frozen as they are."""
    weights, biases = state.actor.layers
    low, high = action_range(env)
    return MlpPolicy(
        weights=weights,
        biases=biases,
        mean=state.statistics.mean,
        std=state.statistics.std,
        action_low=low,
        action_high=high,
        action_std=jnp.exp(state.actor.log_std),
    )


def evaluate(
    simulator: Simulator, policy: MlpPolicy, key: jax.Array, settings: TrustRegionSettings
) -> tuple[Episodes, Metrics]:
    """Return episodes of the Gaussian's mean, and metrics that include some with drawn actions."""
    num_episodes = settings.num_evaluation_episodes
    noise_key, reset_key = jax.random.split(key)
    shape = (num_episodes, settings.episode_length, simulator.env.action_size)
    noise = policy.action_std * jax.random.normal(noise_key, shape)
    episodes = simulator(
        repeated(policy, 2 * num_episodes),
        jax.random.split(reset_key, 2 * num_episodes),
        settings.episode_length,
        noise=jnp.concatenate([jnp.zeros(shape), noise]),
    )
    mean = episodes.first(num_episodes)
    return mean, {
        "evaluation_return": mean.env_returns.mean(),
        "evaluation_length": mean.lengths.mean(),
        "stochastic_return": episodes.env_rewards[num_episodes:].sum(axis=1).mean(),
        "action_std": policy.action_std.mean(),
        **episodes.counts(),
    }


def collect_and_improve(
    env: Env,
    carry: Carry,
    rewards: Callable[[Steps], jax.Array],
    key: jax.Array,
    settings: TrustRegionSettings,
    *,
    merges_states: bool = True,
) -> tuple[Carry, Steps, Metrics]:
    """Collect a batch of steps, :func:`improve` the policy, and merge the statistics if asked."""
    state, running = carry
    collect_key, improve_key = jax.random.split(key)
    num_steps = settings.batch_size // settings.num_envs
    policy = gaussian_policy(env, state)
    running, steps = collect(env, policy, running, collect_key, num_steps, settings.episode_length)
    state, metrics = improve(state, steps, rewards(steps), improve_key, settings)
    if merges_states:
        statistics = normalizer.update(state.statistics, steps.observations, ~steps.copied)
        state = state.replace(statistics=statistics)
    return (state, running), steps, metrics | steps.counts()


def improve(
    state: ActorCritic,
    steps: Steps,
    rewards: jax.Array,
    key: jax.Array,
    settings: TrustRegionSettings,
) -> tuple[ActorCritic, Metrics]:
    """Take one step of the policy in its trust region, then fit the value function.

    Args:
        state: policy and value function that the ``steps`` were made with.
        steps: ``(T, S)`` steps.
        rewards: ``(T, S)``, the environment's or a discriminator's.
        key: of the value function's minibatches.
        settings: of the step and of the fit.
    """
    mean, std = state.statistics.mean, state.statistics.std
    observations = (steps.observations - mean) / std
    values, next_values = (
        _values(state.critic, x) for x in (observations, (steps.next_observations - mean) / std)
    )
    advantages = trust_region.generalized_advantages(
        rewards,
        values,
        next_values,
        steps.terminated,
        steps.over,
        discount=settings.discount,
        decay=settings.advantage_decay,
    )
    targets = advantages + values
    observations, actions, advantages, targets = jax.tree.map(
        lambda x: x.reshape(-1, *x.shape[2:]),
        (observations, steps.drawn_actions, advantages, targets),
    )
    actor, metrics = _improve_actor(state.actor, observations, actions, advantages, settings)
    critic, optimizer, value_loss = _fit_critic(state, observations, targets, key, settings)
    improved = ActorCritic(actor, critic, optimizer, state.statistics)
    return improved, metrics | {"value_loss": value_loss}


def _improve_actor(
    actor: ActorParameters,
    observations: jax.Array,
    actions: jax.Array,
    advantages: jax.Array,
    settings: TrustRegionSettings,
) -> tuple[ActorParameters, Metrics]:
    advantages = (advantages - advantages.mean()) / jnp.maximum(advantages.std(), 1e-8)
    means = perceptron(*actor.layers, observations)
    log_density = trust_region.gaussian_log_density(actions, means, actor.log_std)

    def gain(candidate: ActorParameters) -> jax.Array:
        candidate_means = perceptron(*candidate.layers, observations)
        ratio = (
            trust_region.gaussian_log_density(actions, candidate_means, candidate.log_std)
            - log_density
        )
        return jnp.mean(jnp.exp(ratio) * advantages)

    def divergence(candidate: ActorParameters, stride: int = 1) -> jax.Array:
        candidate_means = perceptron(*candidate.layers, observations[::stride])
        return trust_region.gaussian_divergence(
            means[::stride], actor.log_std, candidate_means, candidate.log_std
        ).mean()

    return trust_region.trust_region_step(
        actor,
        gain,
        divergence,
        lambda candidate: divergence(candidate, FISHER_STRIDE),
        max_divergence=settings.max_divergence,
        iterations=settings.conjugate_gradient_steps,
        damping=settings.conjugate_gradient_damping,
        num_backtracks=settings.num_backtracks,
    )


def _fit_critic(
    state: ActorCritic,
    observations: jax.Array,
    targets: jax.Array,
    key: jax.Array,
    settings: TrustRegionSettings,
) -> tuple[Layers, optax.OptState, jax.Array]:
    """Run Adam on the squared error, in minibatches; an incomplete one of an epoch is left out."""
    size = min(settings.value_batch_size, len(targets))

    def loss(critic: Layers, indices: jax.Array) -> tuple[jax.Array, jax.Array]:
        error = jnp.mean(jnp.square(_values(critic, observations[indices]) - targets[indices]))
        return error, error

    orders = jax.vmap(lambda key: jax.random.permutation(key, len(targets)))(
        jax.random.split(key, settings.value_epochs)
    )
    batches = orders[:, : len(targets) // size * size].reshape(-1, size)
    critic, optimizer, losses = descend(
        _critic_adam(settings), loss, state.critic, state.critic_optimizer, batches
    )
    return critic, optimizer, losses.mean()


def _values(critic: Layers, observations: jax.Array) -> jax.Array:
    return perceptron(*critic, observations).squeeze(-1)


def _critic_adam(settings: TrustRegionSettings) -> optax.GradientTransformation:
    return optax.adam(settings.value_learning_rate)
