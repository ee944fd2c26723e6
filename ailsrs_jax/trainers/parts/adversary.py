"""The discriminator as adversarial imitation learners train and use it."""

import dataclasses
import functools
from collections.abc import Callable
from typing import Annotated, Any, Literal, cast

import jax
import jax.numpy as jnp
import optax
from flax import struct

from ailsrs_jax.components import discriminator
from ailsrs_jax.components.descent import descend
from ailsrs_jax.components.discriminator import LOSSES, REWARDS
from ailsrs_jax.components.finite import finite_or
from ailsrs_jax.components.sampling import sample_steps
from ailsrs_jax.data.demonstrations import Demonstrations
from ailsrs_jax.errors import UserError
from ailsrs_jax.own_code import own_function
from ailsrs_jax.trainers.parts.reference import Reference, make_reference
from ailsrs_jax.trainers.parts.settings import Entries, Positive, PositiveUpToOne, UpToOne, is_used

Sampler = Callable[[jax.Array, int], jax.Array]  # draws (batch, d) inputs of the policy's steps

NETWORK = discriminator.Discriminator()
SCORES = ("discriminator_loss", "policy_score", "expert_score")  # the metrics of training


@dataclasses.dataclass(frozen=True)
class AdversarySettings:
    """Settings of :class:`Adversary`; the defaults are the paper's (Table I)."""

    #: times the median distance of a demonstration to all: those farther away are left out; 0: none
    leave_out_beyond: float = 0.0
    discriminator_sees: Literal["state_action", "state", "state_next_state"] = "state_action"
    discriminator_loss: Annotated[str, LOSSES] = "least_squares"
    discriminator_learning_rate: Positive = 2.5e-4
    discriminator_steps: int = 3
    discriminator_batch_size: int = 1000  #: from each side
    discriminator_entropy_bonus: float = 0.0  #: weight of the scores' entropy in the loss
    discriminator_entries: Entries = "all"  #: of the observation, such as 0:27
    gradient_penalty: float = 0.0  #: weight of the penalty in the loss
    gradient_penalty_decay: PositiveUpToOne = 1.0  #: the share of it that is left at the end
    #: the gap between the scores of expert and policy that the penalty is controlled for; 0: none
    score_gap: UpToOne = 0.0
    imitation_reward: Annotated[str, REWARDS] = "gail"  #: computed from the score


class AdversaryState(struct.PyTreeNode):
    """The part of the discriminator that training changes."""

    parameters: Any  # Flax parameters
    optimizer: optax.OptState
    penalty: jax.Array  # () weight of the gradient penalty, as it is controlled


@dataclasses.dataclass(frozen=True, eq=False)
class Adversary:
    """Tells the expert's steps from a policy's, and rewards the policy for steps like the expert's.

    Its inputs are observations in units of the expert's standard deviation, alone or with the
    action or the next observation.
    """

    settings: AdversarySettings
    reference: Reference

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
        _find(LOSSES, self.settings.discriminator_loss)
        _find(REWARDS, self.settings.imitation_reward)

    @property
    def input_size(self) -> int:
        """Length d of an input."""
        return int(self._expert_inputs().shape[-1])

    def init(self, key: jax.Array) -> AdversaryState:
        """Return an untrained discriminator."""
        parameters = NETWORK.init(key, jnp.zeros(self.input_size))
        penalty = jnp.asarray(self.settings.gradient_penalty, jnp.float32)
        return AdversaryState(parameters, self._adam.init(parameters), penalty)

    def inputs(
        self, observations: jax.Array, actions: jax.Array, next_observations: jax.Array
    ) -> jax.Array:
        """Return inputs ``(..., d)`` for steps of a policy; arrays not seen are ignored."""
        compared = self.reference.compared
        return self._join(compared(observations), actions, compared(next_observations))

    def num_seen(self, lengths: jax.Array) -> jax.Array:
        """Return how many first steps ``(...)`` of episodes can be judged, at least one if any.

        The observation after the last step is not recorded. In an episode of one step, zeros stand
        for it.
        """
        pairs = self.settings.discriminator_sees == "state_next_state"
        return jnp.maximum(lengths - 1, jnp.minimum(lengths, 1)) if pairs else lengths

    def train(
        self,
        state: AdversaryState,
        key: jax.Array,
        sample: Sampler,
        done: jax.Array | float = 0.0,
    ) -> tuple[AdversaryState, dict[str, jax.Array]]:
        """Take ``discriminator_steps`` of Adam; return also the metrics of the last.

        ``sample`` draws inputs of the policy's steps, and ``done`` is the part of the training that
        is done, from 0 to 1.
        """
        settings, lengths = self.settings, self.num_seen(self.reference.lengths)
        highest = settings.gradient_penalty * settings.gradient_penalty_decay**done
        penalty = highest
        if is_used(settings.score_gap):
            penalty = jnp.minimum(state.penalty, highest)
        batch_size = settings.discriminator_batch_size
        loss_of_pairs = _find(LOSSES, settings.discriminator_loss)
        expert_steps = self._expert_inputs()

        def loss(parameters: Any, key: jax.Array) -> tuple[jax.Array, dict[str, jax.Array]]:
            policy_key, expert_key, penalty_key = jax.random.split(key, 3)
            policy_inputs = sample(policy_key, batch_size)
            episode, time = sample_steps(expert_key, lengths, batch_size)
            expert_inputs = expert_steps[episode, time]
            logits = functools.partial(self._logits, parameters)
            policy_logits, expert_logits = logits(policy_inputs), logits(expert_inputs)
            value = loss_of_pairs(policy_logits, expert_logits).mean()
            total = value
            if is_used(settings.gradient_penalty):
                penalties = discriminator.gradient_penalty(
                    logits, policy_inputs, expert_inputs, penalty_key
                )
                total += penalty * penalties.mean()
            if is_used(settings.discriminator_entropy_bonus):
                entropies = jax.tree.map(discriminator.entropy, (policy_logits, expert_logits))
                bonus = ((entropies[0] + entropies[1]) / 2.0).mean()
                total -= settings.discriminator_entropy_bonus * bonus
            return total, {
                "discriminator_loss": value,
                "policy_score": jax.nn.sigmoid(policy_logits).mean(),
                "expert_score": jax.nn.sigmoid(expert_logits).mean(),
            }

        keys = jax.random.split(key, settings.discriminator_steps)
        parameters, optimizer, metrics = descend(
            self._adam, loss, state.parameters, state.optimizer, keys
        )
        metrics = jax.tree.map(lambda x: x[-1], metrics)
        state = state.replace(parameters=parameters, optimizer=optimizer)
        if is_used(settings.score_gap):
            gap = metrics["expert_score"] - metrics["policy_score"]
            controlled = penalty * jnp.exp(2.0 * (gap - settings.score_gap))
            controlled = finite_or(jnp.clip(controlled, 0.03 * highest, highest), state.penalty)
            state = state.replace(penalty=controlled)
        return state, metrics

    def rewards(self, state: AdversaryState, inputs: jax.Array) -> jax.Array:
        """Return rewards ``(...)`` of steps with these ``inputs (..., d)``."""
        reward = _find(REWARDS, self.settings.imitation_reward)
        return reward(self._logits(state.parameters, inputs))

    @property
    def _adam(self) -> optax.GradientTransformation:
        return optax.adam(self.settings.discriminator_learning_rate)

    def _logits(self, parameters: Any, inputs: jax.Array) -> jax.Array:
        return cast("jax.Array", NETWORK.apply(parameters, inputs))

    def _expert_inputs(self) -> jax.Array:
        """Return inputs ``(E, T, d)`` for the expert's steps."""
        observations = self.reference.compared_observations
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


def adversary_reference(demonstrations: Demonstrations, settings: Any) -> Reference:
    """Prepare ``demonstrations`` for a learner with these ``settings``.

    Raises:
        UserError: the demonstrations do not hold what the settings need.
    """
    reference = make_reference(
        demonstrations,
        settings.episode_length,
        settings.num_distance_samples,
        settings.discriminator_entries,
        settings.leave_out_beyond,
    )
    Adversary(settings, reference)  # checks that the demonstrations hold what it sees
    if settings.behavior_cloning_start:
        reference.require_actions("behavior_cloning_start")
    return reference


def _find(known: dict[str, Callable[..., jax.Array]], name: str) -> Callable[..., jax.Array]:
    """Return the function of that name, or the user's own ``module:attribute``."""
    return known[name] if name in known else own_function(name)
