"""The discriminator as adversarial imitation learners train and use it."""

import dataclasses
import functools
from collections.abc import Callable
from typing import Any, Literal, cast

import jax
import jax.numpy as jnp
import optax
from flax import struct

from ailsrs_jax.components import discriminator
from ailsrs_jax.components.finite import finite_or
from ailsrs_jax.components.sampling import sample_steps
from ailsrs_jax.errors import UserError
from ailsrs_jax.trainers.parts.devices import ONE_DEVICE, Devices
from ailsrs_jax.trainers.parts.reference import Reference
from ailsrs_jax.trainers.parts.settings import Positive, is_used

# Draws ``(batch, d)`` inputs of the policy's steps with a key, and says ``(batch)`` bool which of
# them are on this device.
Sampler = Callable[[jax.Array, int], tuple[jax.Array, jax.Array]]


NETWORK = discriminator.Discriminator()


@dataclasses.dataclass(frozen=True)
class AdversarySettings:
    """Settings of :class:`Adversary`; the defaults are the paper's (Table I)."""

    discriminator_sees: Literal["state_action", "state", "state_next_state"] = "state_action"
    discriminator_loss: Literal["least_squares", "cross_entropy"] = "least_squares"
    discriminator_learning_rate: Positive = 2.5e-4
    discriminator_steps: int = 3
    discriminator_batch_size: int = 1000  #: from each side
    discriminator_entropy_bonus: float = 0.0  #: weight of its judgements' entropy in the loss
    gradient_penalty: float = 0.0  #: weight of the penalty in the loss
    imitation_reward: Literal["gail", "airl", "amp"] = "gail"  #: read off the score


class AdversaryState(struct.PyTreeNode):
    """What training the discriminator changes."""

    parameters: Any  # Flax parameters
    optimizer: optax.OptState


@dataclasses.dataclass(frozen=True, eq=False)
class Adversary:
    """Tells the steps of ``expert`` from a policy's, and rewards the policy for failing it.

    Its inputs are observations, in units of the expert's standard deviation, with the action or
    the next observation beside them, or alone.
    """

    settings: AdversarySettings
    reference: Reference
    devices: Devices = ONE_DEVICE

    def __post_init__(self) -> None:
        """Raise UserError unless the demonstrations hold what the discriminator sees."""
        sees = self.settings.discriminator_sees
        if sees == "state_action":
            self.reference.require_actions("discriminator_sees=state_action")
        if sees == "state_next_state" and self.reference.stride > 1:
            raise UserError(
                "the demonstrations are subsampled: discriminator_sees=state_next_state needs "
                "every step, state_action and state do not"
            )

    @property
    def input_size(self) -> int:
        """Length d of an input."""
        return int(self._expert_inputs().shape[-1])

    def init(self, key: jax.Array) -> AdversaryState:
        """An untrained discriminator."""
        parameters = NETWORK.init(key, jnp.zeros(self.input_size))
        return AdversaryState(parameters, self._adam.init(parameters))

    def inputs(
        self, observations: jax.Array, actions: jax.Array, next_observations: jax.Array
    ) -> jax.Array:
        """``(..., d)`` of steps of a policy; arrays that are not seen can be anything."""
        standardize = self.reference.standardize
        return self._join(standardize(observations), actions, standardize(next_observations))

    def num_seen(self, lengths: jax.Array) -> jax.Array:
        """How many steps ``(...)`` of episodes can be judged, the first ones, one if there is any.

        What follows the last step is not recorded. (Of an episode of one step zeros are taken to
        follow.)
        """
        pairs = self.settings.discriminator_sees == "state_next_state"
        return jnp.maximum(lengths - 1, jnp.minimum(lengths, 1)) if pairs else lengths

    def train(
        self, state: AdversaryState, key: jax.Array, sample: Sampler
    ) -> tuple[AdversaryState, dict[str, jax.Array]]:
        """Take ``discriminator_steps`` of Adam; metrics are those of the last."""
        settings, devices, lengths = (
            self.settings,
            self.devices,
            self.num_seen(self.reference.lengths),
        )
        batch_size = settings.discriminator_batch_size
        expert_steps = self._expert_inputs()

        def loss(parameters: Any, key: jax.Array) -> tuple[jax.Array, dict[str, jax.Array]]:
            """This device's part of the mean over pairs: those whose policy step it has."""
            policy_key, expert_key, penalty_key = jax.random.split(key, 3)
            policy_inputs, here = sample(policy_key, batch_size)
            episode, time = sample_steps(expert_key, lengths, batch_size)
            expert_inputs = expert_steps[episode, time]

            def mean(values: jax.Array) -> jax.Array:
                return jnp.sum(values, where=here) / batch_size

            logits = functools.partial(self._logits, parameters)
            policy_logits, expert_logits = logits(policy_inputs), logits(expert_inputs)
            pairs = discriminator.LOSSES[settings.discriminator_loss](policy_logits, expert_logits)
            value = mean(pairs)
            total = value
            if is_used(settings.gradient_penalty):
                total += settings.gradient_penalty * mean(
                    discriminator.gradient_penalty(
                        logits, policy_inputs, expert_inputs, penalty_key
                    )
                )
            if is_used(settings.discriminator_entropy_bonus):
                entropies = jax.tree.map(discriminator.entropy, (policy_logits, expert_logits))
                bonus = mean((entropies[0] + entropies[1]) / 2.0)
                total -= settings.discriminator_entropy_bonus * bonus
            return total, {
                "discriminator_loss": value,
                "policy_score": mean(jax.nn.sigmoid(policy_logits)),
                "expert_score": mean(jax.nn.sigmoid(expert_logits)),
            }

        def adam_step(state: AdversaryState, key: jax.Array) -> tuple[AdversaryState, Any]:
            gradients, metrics = devices.sum(jax.grad(loss, has_aux=True)(state.parameters, key))
            updates, optimizer = self._adam.update(gradients, state.optimizer, state.parameters)
            return AdversaryState(
                optax.apply_updates(state.parameters, updates), optimizer
            ), metrics

        keys = jax.random.split(key, settings.discriminator_steps)
        trained, metrics = jax.lax.scan(adam_step, state, keys)
        return finite_or(trained, state), jax.tree.map(lambda x: x[-1], metrics)

    def rewards(self, state: AdversaryState, inputs: jax.Array) -> jax.Array:
        """Rewards ``(...)`` of steps with these ``inputs (..., d)``."""
        logits = self._logits(state.parameters, inputs)
        return discriminator.REWARDS[self.settings.imitation_reward](logits)

    @property
    def _adam(self) -> optax.GradientTransformation:
        return optax.adam(self.settings.discriminator_learning_rate)

    def _logits(self, parameters: Any, inputs: jax.Array) -> jax.Array:
        return cast("jax.Array", NETWORK.apply(parameters, inputs))

    def _expert_inputs(self) -> jax.Array:
        """``(E, T, d)``."""
        observations = self.reference.observations
        following = jnp.roll(observations, -1, axis=1)
        return self._join(observations, self.reference.actions, following)

    def _join(
        self, observations: jax.Array, actions: jax.Array, next_observations: jax.Array
    ) -> jax.Array:
        beside = {
            "state_action": [actions],
            "state": [],
            "state_next_state": [next_observations],
        }[self.settings.discriminator_sees]
        return jnp.concatenate([observations, *beside], axis=-1)
