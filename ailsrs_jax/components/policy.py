"""Policies: the paper's linear one and multilayer perceptrons; and the best one so far."""

from typing import Any

import jax
import jax.numpy as jnp
from flax import struct


class LinearPolicy(struct.PyTreeNode):
    """A linear policy of standardised observations, a = clip(M diag(Σ)^(−1/2) (s − μ) + b).

    With leading axes on its leaves it is a batch of policies, as ``jax.vmap`` makes them.
    """

    weights: jax.Array  # (p, n) M
    mean: jax.Array  # (n,) μ
    std: jax.Array  # (n,) the square root of Σ's diagonal
    action_low: jax.Array  # (p,)
    action_high: jax.Array  # (p,)
    intercept: jax.Array | None = None  # (p,) b; None is zero, as in the paper

    def __call__(self, observation: jax.Array, noise: jax.Array | float = 0.0) -> jax.Array:
        """Return the action ``(p,)`` for an observation ``(n,)``: noise is added, then clipped."""
        # TF32 would give other actions than NumPy gives with the exported file.
        standardized = (observation - self.mean) / self.std
        action = jnp.matmul(self.weights, standardized, precision="highest")
        action = action if self.intercept is None else action + self.intercept
        return jnp.clip(action + noise, self.action_low, self.action_high)

    @property
    def layers(self) -> "Layers":
        """Weights ``(out, in)`` and biases ``(out,)`` of each layer, as of :class:`MlpPolicy`."""
        bias = jnp.zeros_like(self.action_low) if self.intercept is None else self.intercept
        return (self.weights,), (bias,)

    def with_weights(self, weights: jax.Array) -> "LinearPolicy":
        """Return the batch of policies with these ``weights (B, p, n)`` and its statistics."""
        return repeated(self, len(weights)).replace(weights=weights)


class MlpPolicy(struct.PyTreeNode):
    """A multilayer perceptron of standardised observations, the mean of a Gaussian policy.

    Each layer but the last is ``h ← tanh(W h + b)``, the last ``W h + b``.
    """

    weights: tuple[jax.Array, ...]  # (out, in) of each layer
    biases: tuple[jax.Array, ...]  # (out,)
    mean: jax.Array  # (n,) of the observations
    std: jax.Array  # (n,)
    action_low: jax.Array  # (p,)
    action_high: jax.Array  # (p,)
    action_std: jax.Array  # (p,) of the Gaussian

    def __call__(self, observation: jax.Array, noise: jax.Array | float = 0.0) -> jax.Array:
        """Return the action ``(p,)`` for an observation ``(n,)``: noise is added, then clipped."""
        return self.clip(self.unclipped(observation) + noise)

    @property
    def layers(self) -> "Layers":
        """Weights ``(out, in)`` and biases ``(out,)`` of each layer."""
        return self.weights, self.biases

    def unclipped(self, observation: jax.Array) -> jax.Array:
        """Return the mean ``(p,)`` of the Gaussian for an observation ``(n,)``."""
        return perceptron(self.weights, self.biases, (observation - self.mean) / self.std)

    def clip(self, action: jax.Array) -> jax.Array:
        """Clip an action ``(..., p)`` to the actuators' range."""
        return jnp.clip(action, self.action_low, self.action_high)


Policy = LinearPolicy | MlpPolicy
Layers = tuple[tuple[jax.Array, ...], tuple[jax.Array, ...]]


def perceptron(
    weights: tuple[jax.Array, ...], biases: tuple[jax.Array, ...], inputs: jax.Array
) -> jax.Array:
    """Return outputs ``(..., out)`` of a multilayer perceptron for ``inputs (..., in)``.

    Each layer has ``weights (out, in)`` and ``biases (out,)``; all but the last end in tanh.
    """
    hidden = hidden_units(weights[:-1], biases[:-1], inputs)
    return jnp.matmul(hidden, weights[-1].T, precision="highest") + biases[-1]


def hidden_units(
    weights: tuple[jax.Array, ...], biases: tuple[jax.Array, ...], inputs: jax.Array
) -> jax.Array:
    """Return the last tanh units ``(..., out)`` of these layers; without layers, the ``inputs``."""
    for matrix, bias in zip(weights, biases, strict=True):
        inputs = jnp.tanh(jnp.matmul(inputs, matrix.T, precision="highest") + bias)
    return inputs


def repeated(policy: Any, num_policies: int) -> Any:
    """Return a batch of ``num_policies`` copies of ``policy``."""
    return jax.tree.map(lambda x: jnp.broadcast_to(x, (num_policies, *x.shape)), policy)


class KeptPolicy(struct.PyTreeNode):
    """A policy with the best score so far or, with ``within``, nearly; and the last candidate."""

    policy: Policy
    score: jax.Array  # () its own, higher is better; −∞ before the first candidate
    highest: jax.Array  # () the highest score of all candidates
    iteration: jax.Array  # () int32, in which it was found
    offered: Policy  # the last candidate

    def offer(
        self,
        policy: Policy,
        score: jax.Array,
        iteration: jax.Array,
        within: jax.Array | float = 1.0,
    ) -> "KeptPolicy":
        """Keep ``policy`` instead if its score is above ``within`` times the highest so far.

        Scores are negative distances if ``within`` is above 1. NaN is never kept.
        """
        highest = jnp.fmax(score, self.highest)
        candidate = KeptPolicy(policy, score, highest, iteration, policy)
        better = score > within * self.highest
        kept = jax.tree.map(lambda new, old: jnp.where(better, new, old), candidate, self)
        return kept.replace(highest=highest, offered=policy)


def keep(policy: Policy) -> KeptPolicy:
    """Start with ``policy``; the first candidate with a score replaces it."""
    return KeptPolicy(
        policy,
        score=jnp.full((), -jnp.inf, jnp.float32),
        highest=jnp.full((), -jnp.inf, jnp.float32),
        iteration=jnp.zeros((), jnp.int32),
        offered=policy,
    )
