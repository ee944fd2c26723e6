"""The discriminator: its network, its losses, and the rewards computed from its score.

Everywhere in this package, the score D(s, a) = sigmoid(logit) is the estimated probability that a
step is the expert's. The label of the expert is 1 (b in the paper), that of the policy 0 (a).
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp
from flax import linen as nn

EXPERT_LABEL = 1.0
POLICY_LABEL = 0.0

HIDDEN_SIZES = (100, 100)


class Discriminator(nn.Module):
    """The paper's multilayer perceptron: two hidden layers of 100 tanh units."""

    @nn.compact
    def __call__(self, inputs: jax.Array) -> jax.Array:
        """Return logits ``(...)`` of inputs ``(..., d)``; they are high for the expert."""
        hidden = inputs
        for size in HIDDEN_SIZES:
            hidden = nn.tanh(nn.Dense(size)(hidden))
        return nn.Dense(1)(hidden).squeeze(-1)


def least_squares_loss(policy_logits: jax.Array, expert_logits: jax.Array) -> jax.Array:
    """Return the loss ``(batch)`` of LS-GAN (Mao et al., 2017), ½(D_e − 1)² + ½(D_p − 0)².

    Its mean over pairs of steps is ½ E_expert[(D − 1)²] + ½ E_policy[(D − 0)²].
    """
    expert_error = jax.nn.sigmoid(expert_logits) - EXPERT_LABEL
    policy_error = jax.nn.sigmoid(policy_logits) - POLICY_LABEL
    return 0.5 * jnp.square(expert_error) + 0.5 * jnp.square(policy_error)


def cross_entropy_loss(policy_logits: jax.Array, expert_logits: jax.Array) -> jax.Array:
    """Return GAIL's loss ``(batch)`` (Ho and Ermon, 2016), −log D_e − log(1 − D_p)."""
    return jax.nn.softplus(-expert_logits) + jax.nn.softplus(policy_logits)


def entropy(logits: jax.Array) -> jax.Array:
    """Return the entropy ``(...)`` of the score in nats, −D log D − (1 − D) log(1 − D)."""
    return jax.nn.softplus(logits) - jax.nn.sigmoid(logits) * logits


def gradient_penalty(
    logit_function: Callable[[jax.Array], jax.Array],
    policy_inputs: jax.Array,
    expert_inputs: jax.Array,
    key: jax.Array,
) -> jax.Array:
    """Return ‖∇_x D(x)‖² ``(batch)`` at random points between pairs of inputs ``(batch, d)``.

    The penalty bounds the slope of the score between policy and expert. So the reward stays
    informative when the two are easy to tell apart (Thanh-Tung et al., 2019).
    ``logit_function`` takes one input ``(d,)``.
    """
    fractions = jax.random.uniform(key, (policy_inputs.shape[0], 1))
    points = fractions * policy_inputs + (1.0 - fractions) * expert_inputs
    gradients = jax.vmap(jax.grad(lambda x: jax.nn.sigmoid(logit_function(x))))(points)
    return jnp.sum(jnp.square(gradients), axis=-1)


def gail_reward(logits: jax.Array) -> jax.Array:
    """Return the paper's reward of a step, −log(1 − D) = softplus(logit) > 0."""
    return jax.nn.softplus(logits)


def airl_reward(logits: jax.Array) -> jax.Array:
    """Return AIRL's reward (Fu et al., 2018), log D − log(1 − D) = logit, of either sign."""
    return logits


def amp_reward(logits: jax.Array) -> jax.Array:
    """Return AMP's reward (Peng et al., 2021), 1 − (1 − D)² from 0 to 1.

    AMP writes it as max(0, 1 − ¼ (d − 1)²) for labels −1 and 1; here d = 2 D − 1.
    """
    return 1.0 - jnp.square(1.0 - jax.nn.sigmoid(logits))


# A loss or reward of this package is a function above and an entry here.
LOSSES: dict[str, Callable[..., jax.Array]] = {
    "least_squares": least_squares_loss,
    "cross_entropy": cross_entropy_loss,
}
REWARDS: dict[str, Callable[..., jax.Array]] = {
    "gail": gail_reward,
    "airl": airl_reward,
    "amp": amp_reward,
}
