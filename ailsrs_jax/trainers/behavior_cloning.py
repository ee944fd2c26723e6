"""Behaviour cloning: a linear policy by supervised learning of the expert's actions."""

import dataclasses
from typing import Literal

import jax
import jax.numpy as jnp
import optax
from flax import struct

from ailsrs_jax.components.descent import descend
from ailsrs_jax.components.linear_regression import ridge_regression
from ailsrs_jax.components.policy import KeptPolicy, LinearPolicy, keep
from ailsrs_jax.components.sampling import sample_steps
from ailsrs_jax.data.demonstrations import Demonstrations
from ailsrs_jax.envs import Env
from ailsrs_jax.envs.interface import action_range
from ailsrs_jax.trainers import presets
from ailsrs_jax.trainers.parts.reference import Reference, make_reference, require_sizes
from ailsrs_jax.trainers.parts.rollout import Simulator, as_simulator
from ailsrs_jax.trainers.parts.settings import (
    Positive,
    PositiveUpToOne,
    require_countable,
    validate,
)
from ailsrs_jax.trainers.parts.trainer import Algorithm, Metrics, Trainer


@dataclasses.dataclass(frozen=True)
class BehaviorCloningSettings:
    """Settings of :class:`BehaviorCloning`; the paper says Adam and no more."""

    num_iterations: int = 100  #: at most
    solver: Literal["adam", "ridge"] = "adam"  #: ridge is the exact solution, in one iteration
    learning_rate: Positive = 1e-3
    gradient_steps: int = 100  #: of Adam, each iteration
    batch_size: int = 256
    validation_fraction: PositiveUpToOne = 0.1  #: of the demonstrations, not trained on
    patience: int = 10  #: iterations without a smaller validation loss until the end
    episode_length: int = 1000
    num_evaluation_episodes: int = 4
    num_distance_samples: int = 1500  #: from each side

    @property
    def steps_per_iteration(self) -> int:
        """Environment steps that an iteration simulates at most."""
        return self.num_evaluation_episodes * self.episode_length


class TrainState(struct.PyTreeNode):
    """The state that one iteration hands to the next."""

    weights: jax.Array  # (p, n)
    optimizer: optax.OptState
    kept: KeptPolicy  # of the smallest validation loss so far
    key: jax.Array
    iteration: jax.Array  # () int32
    finished: jax.Array  # () bool, the validation loss has stopped falling


@dataclasses.dataclass(frozen=True, eq=False)
class BehaviorCloning(Trainer):
    """Clones the expert of ``reference``; the environment only shows how good the clone is.

    Minimises E ‖M z − a‖² over the expert's actions a and observations z, standardised with its
    own statistics. Steps that are held out decide when to stop and which policy to keep.
    """

    simulator: Simulator
    settings: BehaviorCloningSettings
    reference: Reference

    def init(self, key: jax.Array) -> TrainState:
        """Start with weights of zero."""
        weights = jnp.zeros((self.env.action_size, self.env.observation_size))
        return TrainState(
            weights=weights,
            optimizer=self._adam.init(weights),
            kept=keep(self.policy(weights)),
            key=key,
            iteration=jnp.zeros((), jnp.int32),
            finished=jnp.zeros((), bool),
        )

    def update(self, state: TrainState) -> tuple[TrainState, Metrics]:
        """Take some steps of Adam, or solve exactly; then measure the losses and the return."""
        settings, expert = self.settings, self.reference
        key, batch_key, reset_key, distance_key = jax.random.split(state.key, 4)
        lengths = training_lengths(expert.lengths, settings.validation_fraction)
        training = jnp.arange(expert.observations.shape[1]) < lengths[:, None]

        weights, optimizer = state.weights, state.optimizer
        if settings.solver == "ridge":
            weights = ridge_regression(expert.observations, expert.actions, training)
        else:
            weights, optimizer = self._descend(weights, optimizer, lengths, batch_key)
        validation_loss = self._loss(weights, expert.alive & ~training)
        policy = self.policy(weights)
        kept = state.kept.offer(policy, -validation_loss, state.iteration)
        waited = state.iteration - kept.iteration >= settings.patience

        evaluation, evaluated = self.evaluate(policy, reset_key)
        metrics = evaluated | {
            "expert_distance": expert.distance(distance_key, evaluation, settings.episode_length),
            "training_loss": self._loss(weights, training),
            "validation_loss": validation_loss,
        }
        state = TrainState(
            weights=weights,
            optimizer=optimizer,
            kept=kept,
            key=key,
            iteration=state.iteration + 1,
            finished=waited | (settings.solver == "ridge"),
        )
        return state, metrics

    def policy(self, weights: jax.Array) -> LinearPolicy:
        """Return the policy, with the expert's statistics."""
        statistics = self.reference.statistics
        return LinearPolicy(weights, statistics.mean, statistics.std, *action_range(self.env))

    @property
    def _adam(self) -> optax.GradientTransformation:
        return optax.adam(self.settings.learning_rate)

    def _descend(
        self, weights: jax.Array, optimizer: optax.OptState, lengths: jax.Array, key: jax.Array
    ) -> tuple[jax.Array, optax.OptState]:
        """Run Adam on minibatches of the first ``lengths (E,)`` steps of each demonstration."""
        settings, expert = self.settings, self.reference

        def loss(weights: jax.Array, key: jax.Array) -> tuple[jax.Array, None]:
            episode, time = sample_steps(key, lengths, settings.batch_size)
            predicted = expert.observations[episode, time] @ weights.T
            errors = jnp.square(predicted - expert.actions[episode, time])
            return errors.sum(axis=-1).mean(), None

        keys = jax.random.split(key, settings.gradient_steps)
        weights, optimizer, _ = descend(self._adam, loss, weights, optimizer, keys)
        return weights, optimizer

    def _loss(self, weights: jax.Array, mask: jax.Array) -> jax.Array:
        """Return the mean of ‖M z − a‖² over the steps where ``mask (E, T)`` is true."""
        errors = jnp.square(self.reference.observations @ weights.T - self.reference.actions)
        return jnp.sum(errors, where=mask[..., None]) / jnp.maximum(mask.sum(), 1)


def training_lengths(lengths: jax.Array, validation_fraction: float) -> jax.Array:
    """Return how many first steps ``(E,)`` of each episode are trained on.

    The last episodes are held out as a whole, because steps of the same episode are too alike to
    detect overfitting. A single episode is cut in two. Episodes without steps come last and do not
    count.
    """
    num_episodes = jnp.sum(lengths > 0)
    held_out = jnp.clip(jnp.round(num_episodes * validation_fraction), 1, num_episodes - 1)
    first_part = jnp.ceil(lengths * (1.0 - validation_fraction)).astype(jnp.int32)
    first_part = jnp.minimum(first_part, lengths - 1)  # hold out something of a short one, too
    return jnp.where(
        num_episodes == 1,
        jnp.where(lengths > 0, jnp.maximum(first_part, 1), 0),
        jnp.where(jnp.arange(len(lengths)) < num_episodes - held_out, lengths, 0),
    )


def make_behavior_cloning(
    env: Env | Simulator, demonstrations: Demonstrations, settings: BehaviorCloningSettings
) -> BehaviorCloning:
    """Prepare the demonstrations for cloning; see :class:`BehaviorCloning`.

    Raises:
        UserError: a setting makes no sense, or the demonstrations do not fit the environment or
            hold no actions.
    """
    validate(settings)
    require_countable(settings.steps_per_iteration)
    simulator = as_simulator(env)
    require_sizes(demonstrations, simulator.env)
    expert = make_reference(demonstrations, settings.episode_length, settings.num_distance_samples)
    expert.require_actions("behaviour cloning")
    return BehaviorCloning(simulator, settings, expert)


BEHAVIOR_CLONING = Algorithm(
    "BC",
    make_behavior_cloning,
    BehaviorCloningSettings,
    presets.DEFAULTS,
    kept_by="validation_loss",
)
