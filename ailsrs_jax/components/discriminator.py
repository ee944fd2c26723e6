"""The discriminator: its network, its losses and the rewards read off it.

Convention, here and everywhere: the score D(s, a) = sigmoid(logit) is the judged probability that
a step is the expert's. The expert's label is 1 (the paper's b) and the policy's is 0 (its a).
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp
from flax import linen as nn

EXPERT_LABEL = 1.0
POLICY_LABEL = 0.0

LogitFunction = Callable[[jax.Array], jax.Array]  # inputs (..., d) → logits (...)


HIDDEN_SIZES = (100, 100)


class Discriminator(nn.Module):
    """The paper's multilayer perceptron: two hidden layers of 100 tanh units."""

    @nn.compact
    def __call__(self, inputs: jax.Array) -> jax.Array:
        """Logits ``(...)`` of inputs ``(..., d)``; expert-like is high."""
        hidden = inputs
        for size in HIDDEN_SIZES:
            hidden = nn.tanh(nn.Dense(size)(hidden))
        logits: jax.Array = nn.Dense(1)(hidden).squeeze(-1)
        return logits


def least_squares_loss(policy_logits: jax.Array, expert_logits: jax.Array) -> jax.Array:
    """LS-GAN (Mao et al., 2017): the loss ``(batch)`` of pairs of steps, ½(D_e − 1)² + ½(D_p − 0)².

    Its mean is ½ E_expert[(D − 1)²] + ½ E_policy[(D − 0)²].
    """
    expert_error = jax.nn.sigmoid(expert_logits) - EXPERT_LABEL
    policy_error = jax.nn.sigmoid(policy_logits) - POLICY_LABEL
    return 0.5 * jnp.square(expert_error) + 0.5 * jnp.square(policy_error)


def cross_entropy_loss(policy_logits: jax.Array, expert_logits: jax.Array) -> jax.Array:
    """GAIL's (Ho and Ermon, 2016): the loss ``(batch)`` of pairs, −log D_e − log(1 − D_p)."""
    return jax.nn.softplus(-expert_logits) + jax.nn.softplus(policy_logits)


def entropy(logits: jax.Array) -> jax.Array:
    """Entropy ``(...)`` in nats of the judgement, −D log D − (1 − D) log(1 − D)."""
    return jax.nn.softplus(logits) - jax.nn.sigmoid(logits) * logits


def gradient_penalty(
    logit_function: LogitFunction,
    policy_inputs: jax.Array,
    expert_inputs: jax.Array,
    key: jax.Array,
) -> jax.Array:
    """``(batch)`` ‖∇_x D(x)‖² at random points x between pairs of the inputs ``(batch, d)``.

    Zero-centred: it bounds how steep the score can get between policy and expert, which keeps the
    reward informative when the two are easily told apart (Thanh-Tung et al., 2019).
    """
    fractions = jax.random.uniform(key, (policy_inputs.shape[0], 1))
    points = fractions * policy_inputs + (1.0 - fractions) * expert_inputs
    gradients = jax.vmap(jax.grad(lambda x: jax.nn.sigmoid(logit_function(x))))(points)
    return jnp.sum(jnp.square(gradients), axis=-1)


def gail_reward(logits: jax.Array) -> jax.Array:
    """The paper's reward of a step, −log(1 − D) = softplus(logit) > 0; expert-like is high."""
    return jax.nn.softplus(logits)


def airl_reward(logits: jax.Array) -> jax.Array:
    """AIRL's (Fu et al., 2018) reward of a step, log D − log(1 − D) = logit, of either sign."""
    return logits


def amp_reward(logits: jax.Array) -> jax.Array:
    """AMP's (Peng et al., 2021) reward of a step, 1 − (1 − D)² from 0 to 1.

    There it is max(0, 1 − ¼ (d − 1)²) for labels −1 and 1, which d = 2 D − 1 turns into this.
    """
    return 1.0 - jnp.square(1.0 - jax.nn.sigmoid(logits))


LOSSES = {"least_squares": least_squares_loss, "cross_entropy": cross_entropy_loss}
REWARDS = {"gail": gail_reward, "airl": airl_reward, "amp": amp_reward}
