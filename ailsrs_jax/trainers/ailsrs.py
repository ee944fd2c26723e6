"""Adversarial imitation learning via random search (Shin and Kim, IJCNN 2019)."""

import dataclasses
import functools
from typing import Any, Literal, cast

import jax
import jax.numpy as jnp
import optax
from flax import struct

from ailsrs_jax.components import discriminator as adversary
from ailsrs_jax.components import normalizer, random_search
from ailsrs_jax.components.energy_distance import energy_distance, mean_distance
from ailsrs_jax.components.linear_regression import ridge_regression
from ailsrs_jax.components.normalizer import RunningStatistics
from ailsrs_jax.components.policy import KeptPolicy, LinearPolicy, keep
from ailsrs_jax.components.sampling import SampleMemory, empty_memory, sample_steps
from ailsrs_jax.data.demonstrations import Demonstrations
from ailsrs_jax.envs import Env
from ailsrs_jax.trainers.rollout import Rollout, action_range, rollout

Metrics = dict[str, jax.Array]


@dataclasses.dataclass(frozen=True)
class AilsrsSettings:
    """Settings of :class:`Ailsrs`; the defaults are the paper's (Table I)."""

    num_iterations: int = 100_000
    num_directions: int = 320
    num_top_directions: int = 320  # the paper uses all
    step_size: float = 0.02
    final_step_size: float = 0.02  # reached linearly at the last iteration
    noise_std: float = 0.03
    episode_length: int = 1000
    discriminator_learning_rate: float = 2.5e-4
    discriminator_steps: int = 3
    discriminator_batch_size: int = 1000  # from each side
    gradient_penalty: float = 0.0  # weight of the penalty in the discriminator's loss
    memory_iterations: int = 1  # the discriminator sees the policies of so many iterations
    memory_samples: int = 4000  # remembered of each iteration
    reward_reduction: Literal["mean", "sum"] = "mean"  # over the live steps of a rollout
    behavior_cloning_start: bool = False
    standardize_with: Literal["running", "expert"] = "running"  # whose statistics
    num_evaluation_episodes: int = 4
    num_distance_samples: int = 1500  # from each side, for the choice of the policy to keep


class TrainState(struct.PyTreeNode):
    """What one iteration hands to the next."""

    weights: jax.Array  # (p, n)
    statistics: RunningStatistics  # what observations are standardised with
    discriminator: Any  # Flax parameters
    optimizer: optax.OptState
    memory: SampleMemory  # discriminator inputs of recent policies
    kept: KeptPolicy  # closest to the expert so far, by energy distance
    key: jax.Array
    iteration: jax.Array  # () int32


class Expert(struct.PyTreeNode):
    """The demonstrations as training uses them, made by :func:`make_ailsrs`."""

    inputs: jax.Array  # (E, T, n + p) discriminator inputs
    lengths: jax.Array  # (E,) int32
    statistics: RunningStatistics  # of the expert's observations, the fixed scale of the inputs
    distance_features: jax.Array  # (m, n + p + 1), drawn once
    distance_spread: jax.Array  # () mean distance among them


@dataclasses.dataclass(frozen=True, eq=False)
class Ailsrs:
    """Imitates ``expert`` in ``env``, whose reward is measured but never used."""

    env: Env
    settings: AilsrsSettings
    expert: Expert
    network: adversary.Discriminator = dataclasses.field(default_factory=adversary.Discriminator)

    def init(self, key: jax.Array) -> TrainState:
        """The paper's start, all weights zero and no statistics; or behaviour cloning's."""
        key, network_key = jax.random.split(key)
        input_size = self.expert.inputs.shape[-1]
        parameters = self.network.init(network_key, jnp.zeros(input_size))
        statistics = normalizer.init(self.env.observation_size)
        weights = jnp.zeros((self.env.action_size, self.env.observation_size))
        if self.settings.standardize_with == "expert" or self.settings.behavior_cloning_start:
            statistics = self.expert.statistics
        if self.settings.behavior_cloning_start:
            states, actions = jnp.split(self.expert.inputs, [self.env.observation_size], axis=-1)
            alive = jnp.arange(states.shape[1]) < self.expert.lengths[:, None]
            weights = ridge_regression(states, actions, alive)
        return TrainState(
            weights=weights,
            statistics=statistics,
            discriminator=parameters,
            optimizer=self._adam.init(parameters),
            memory=empty_memory(
                self.settings.memory_iterations, self.settings.memory_samples, input_size
            ),
            kept=keep(self.policy(weights, statistics)),
            key=key,
            iteration=jnp.zeros((), jnp.int32),
        )

    def policy(self, weights: jax.Array, statistics: RunningStatistics) -> LinearPolicy:
        """The unperturbed policy, with statistics frozen as they are."""
        return LinearPolicy(weights, statistics.mean, statistics.std, *action_range(self.env))

    def update(self, state: TrainState) -> tuple[TrainState, Metrics]:
        """One iteration of the paper's Algorithm 2.

        The unperturbed policy's evaluation episodes are simulated in the same batch. They measure
        its distance to the expert, which decides what to keep, and its return, for people to see;
        neither the search nor the discriminator learns from them.
        """
        settings, n = self.settings, self.settings.num_directions
        keys = jax.random.split(state.key, 6)
        key, noise_key, reset_key, memory_key, discriminator_key, distance_key = keys

        # 1. Roll out the 2N perturbed policies, and the unperturbed one a few times.
        deltas = random_search.sample_directions(noise_key, n, state.weights.shape)
        perturbed = random_search.perturb(state.weights, deltas, settings.noise_std)
        unperturbed = jnp.tile(state.weights, (settings.num_evaluation_episodes, 1, 1))
        policy = self.policy(state.weights, state.statistics)
        batch = rollout(
            self.env,
            policy.with_weights(jnp.concatenate([perturbed, unperturbed])),
            jax.random.split(reset_key, 2 * n + settings.num_evaluation_episodes),
            settings.episode_length,
        )
        explored, evaluation = batch.episodes(0, 2 * n), batch.episodes(2 * n)

        # 2. Train the discriminator to tell their steps from the expert's.
        memory = state.memory.insert(self._sample_inputs(memory_key, explored))
        parameters, optimizer, discriminator_metrics = self._train_discriminator(
            state, memory, discriminator_key
        )

        # 3. Let it judge every rollout, and 4. step along the directions it liked.
        returns = self._imitation_returns(parameters, explored)
        weights = random_search.step(
            state.weights,
            deltas,
            returns[:n],
            returns[n:],
            step_size=self._step_size(state.iteration),
            num_top_directions=settings.num_top_directions,
        )

        # 5. Merge the states met into the statistics that the next iteration standardises with.
        statistics = state.statistics
        if settings.standardize_with == "running":
            statistics = normalizer.update(statistics, explored.observations, explored.alive)

        distance = self._distance_to_expert(distance_key, evaluation)
        metrics = {
            "evaluation_return": evaluation.env_returns.mean(),
            "evaluation_length": evaluation.lengths.mean(),
            "expert_distance": distance,
            "imitation_reward": returns.mean(),
            **discriminator_metrics,
            "env_steps": batch.env_steps,
        }
        state = TrainState(
            weights=weights,
            statistics=statistics,
            discriminator=parameters,
            optimizer=optimizer,
            memory=memory,
            kept=state.kept.offer(policy, -distance, state.iteration),
            key=key,
            iteration=state.iteration + 1,
        )
        return state, metrics

    def train(self, key: jax.Array) -> tuple[TrainState, Metrics]:
        """The whole run as one function of a key; metrics are stacked over iterations."""
        return jax.lax.scan(
            lambda state, _: self.update(state),
            self.init(key),
            length=self.settings.num_iterations,
        )

    @property
    def _adam(self) -> optax.GradientTransformation:
        return optax.adam(self.settings.discriminator_learning_rate)

    def _logits(self, parameters: Any, inputs: jax.Array) -> jax.Array:
        return cast("jax.Array", self.network.apply(parameters, inputs))

    def _step_size(self, iteration: jax.Array) -> jax.Array:
        settings = self.settings
        progress = iteration / max(settings.num_iterations - 1, 1)
        return settings.step_size + progress * (settings.final_step_size - settings.step_size)

    def _sample_inputs(self, key: jax.Array, episodes: Rollout) -> jax.Array:
        """Discriminator inputs of live steps drawn uniformly, one memory slot of them."""
        episode, time = sample_steps(key, episodes.lengths, self.settings.memory_samples)
        return discriminator_inputs(
            self.expert.statistics,
            episodes.observations[time, episode],
            episodes.actions[time, episode],
        )

    def _train_discriminator(
        self, state: TrainState, memory: SampleMemory, key: jax.Array
    ) -> tuple[Any, optax.OptState, Metrics]:
        settings, expert = self.settings, self.expert

        def loss(parameters: Any, key: jax.Array) -> tuple[jax.Array, Metrics]:
            policy_key, expert_key, penalty_key = jax.random.split(key, 3)
            batch_size = settings.discriminator_batch_size
            policy_inputs = memory.sample(policy_key, batch_size)
            episode, time = sample_steps(expert_key, expert.lengths, batch_size)
            expert_inputs = expert.inputs[episode, time]

            logits = functools.partial(self._logits, parameters)
            policy_logits, expert_logits = logits(policy_inputs), logits(expert_inputs)
            value = adversary.least_squares_loss(policy_logits, expert_logits)
            penalty = adversary.gradient_penalty(logits, policy_inputs, expert_inputs, penalty_key)
            return value + settings.gradient_penalty * penalty, {
                "discriminator_loss": value,
                "policy_score": jax.nn.sigmoid(policy_logits).mean(),
                "expert_score": jax.nn.sigmoid(expert_logits).mean(),
            }

        def adam_step(carry: Any, key: jax.Array) -> tuple[Any, Metrics]:
            parameters, optimizer = carry
            gradients, metrics = jax.grad(loss, has_aux=True)(parameters, key)
            updates, optimizer = self._adam.update(gradients, optimizer, parameters)
            return (optax.apply_updates(parameters, updates), optimizer), metrics

        (parameters, optimizer), metrics = jax.lax.scan(
            adam_step,
            (state.discriminator, state.optimizer),
            jax.random.split(key, settings.discriminator_steps),
        )
        return parameters, optimizer, jax.tree.map(lambda x: x[-1], metrics)

    def _imitation_returns(self, parameters: Any, episodes: Rollout) -> jax.Array:
        """``(B,)`` reward of each rollout: E over its live steps of −log(1 − D), or the sum.

        In slices of time, which bounds the memory and stops where the last episode does.
        """
        num_steps = episodes.observations.shape[0]
        slice_length = min(50, num_steps)

        def add_slice(index: jax.Array, totals: jax.Array) -> jax.Array:
            start = jnp.minimum(index * slice_length, num_steps - slice_length)
            observations, actions = (
                jax.lax.dynamic_slice_in_dim(x, start, slice_length)
                for x in (episodes.observations, episodes.actions)
            )
            inputs = discriminator_inputs(self.expert.statistics, observations, actions)
            rewards = adversary.imitation_reward(self._logits(parameters, inputs))
            time = start + jnp.arange(slice_length)[:, None]
            counts = (time >= index * slice_length) & (time < episodes.lengths)
            return totals + jnp.sum(rewards, axis=0, where=counts)

        num_slices = -(-episodes.lengths.max() // slice_length)
        totals = jax.lax.fori_loop(0, num_slices, add_slice, jnp.zeros(episodes.lengths.shape))
        return totals / episodes.lengths if self.settings.reward_reduction == "mean" else totals

    def _distance_to_expert(self, key: jax.Array, episodes: Rollout) -> jax.Array:
        inputs = discriminator_inputs(
            self.expert.statistics, episodes.observations, episodes.actions
        ).swapaxes(0, 1)
        horizon = _horizon(self.expert.inputs, self.settings)
        features = distance_features(key, inputs, episodes.lengths, horizon, self.settings)
        expert = self.expert
        return energy_distance(features, expert.distance_features, expert.distance_spread)


def make_ailsrs(env: Env, demonstrations: Demonstrations, settings: AilsrsSettings) -> Ailsrs:
    """Prepare the demonstrations for training in ``env``."""
    observations, actions, lengths, alive = map(
        jnp.asarray,
        (
            demonstrations.observations,
            demonstrations.actions,
            demonstrations.lengths,
            demonstrations.alive,
        ),
    )
    statistics = normalizer.update(normalizer.init(observations.shape[-1]), observations, alive)
    inputs = discriminator_inputs(statistics, observations, actions)
    features = distance_features(
        jax.random.key(0), inputs, lengths, _horizon(inputs, settings), settings
    )
    spread = mean_distance(features, features)
    return Ailsrs(env, settings, Expert(inputs, lengths, statistics, features, spread))


def _horizon(expert_inputs: jax.Array, settings: AilsrsSettings) -> int:
    # Beyond the demonstrations' own time limit nobody knows what the expert would have done.
    return min(settings.episode_length, expert_inputs.shape[1])


def discriminator_inputs(
    expert_statistics: RunningStatistics, observations: jax.Array, actions: jax.Array
) -> jax.Array:
    """``(..., n + p)``: observations in units of the expert's standard deviation, and actions.

    The scale is fixed, so that the reward does not drift while the policy's statistics move.
    """
    states = (observations - expert_statistics.mean) / expert_statistics.std
    return jnp.concatenate([states, actions], axis=-1)


def distance_features(
    key: jax.Array, inputs: jax.Array, lengths: jax.Array, horizon: int, settings: AilsrsSettings
) -> jax.Array:
    """Draw ``(m, n + p + 1)`` points for the energy distance from the episodes' ``inputs``.

    Moments are drawn from the first ``horizon`` steps. After an episode's end the state is an
    absorbing one, all zeros but for the last entry, which puts it as far from the others as they
    are from one another; so episodes of another length than the expert's are seen to be different.
    """
    episode_key, time_key = jax.random.split(key)
    num_samples = settings.num_distance_samples
    episode = jax.random.randint(episode_key, (num_samples,), 0, lengths.shape[0])
    time = jax.random.randint(time_key, (num_samples,), 0, horizon)
    alive = (time < lengths[episode])[:, None]
    points = jnp.where(alive, inputs[episode, time], 0.0)
    absorbed = jnp.where(alive, 0.0, jnp.sqrt(inputs.shape[-1]))
    return jnp.concatenate([points, absorbed], axis=-1)
