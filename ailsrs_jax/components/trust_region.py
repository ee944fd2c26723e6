"""Trust region policy optimization (Schulman et al., ICML 2015): its mathematics."""

from collections.abc import Callable
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree
from jax.scipy.sparse.linalg import cg

# A step may exceed the bound on the divergence by this factor: both are estimates from a batch.
DIVERGENCE_SLACK = 1.5

Parameters = TypeVar("Parameters")


def generalized_advantages(
    rewards: jax.Array,
    values: jax.Array,
    next_values: jax.Array,
    terminated: jax.Array,
    over: jax.Array,
    *,
    discount: float,
    decay: float,
) -> jax.Array:
    """Return generalized advantage estimates ``(T, ...)`` (Schulman et al., ICLR 2016).

        A_t = δ_t + γ λ A_{t+1},   δ_t = r_t + γ V(s_{t+1}) − V(s_t)

    V(s_{t+1}) counts as 0 for a terminal state. The sum ends where an episode is over, in a
    terminal state or at its time limit.

    All arrays are ``(T, ...)``. ``next_values`` are those of the next state of the same episode,
    ``terminated`` says whether that state is terminal, and ``over`` whether the episode ended
    there. γ is ``discount``, and λ ``decay``.
    """
    errors = rewards + discount * jnp.where(terminated, 0.0, next_values) - values

    def backwards(
        following: jax.Array, step: tuple[jax.Array, jax.Array]
    ) -> tuple[jax.Array, jax.Array]:
        error, over = step
        advantage = error + discount * decay * jnp.where(over, 0.0, following)
        return advantage, advantage

    _, advantages = jax.lax.scan(backwards, jnp.zeros_like(errors[0]), (errors, over), reverse=True)
    return advantages


def gaussian_log_density(actions: jax.Array, means: jax.Array, log_std: jax.Array) -> jax.Array:
    """Return log densities ``(...)`` of actions ``(..., p)``, N(means, diag(exp(2 log_std)))."""
    z = (actions - means) / jnp.exp(log_std)
    return jnp.sum(-0.5 * jnp.square(z) - log_std - 0.5 * jnp.log(2.0 * jnp.pi), axis=-1)


def gaussian_divergence(
    means: jax.Array, log_std: jax.Array, other_means: jax.Array, other_log_std: jax.Array
) -> jax.Array:
    """Return KL(first ‖ other) ``(...)`` of diagonal Gaussians, in nats."""
    variance, other_variance = jnp.exp(2.0 * log_std), jnp.exp(2.0 * other_log_std)
    squares = (variance + jnp.square(means - other_means)) / (2.0 * other_variance)
    return jnp.sum(other_log_std - log_std + squares - 0.5, axis=-1)


def fisher_product(
    divergence: Callable[[jax.Array], jax.Array], parameters: jax.Array, vector: jax.Array
) -> jax.Array:
    """Return F v, where F is the Hessian of ``divergence`` at its minimum, the Fisher matrix.

    Forward over reverse differentiation does not form the matrix.
    """
    return jax.jvp(jax.grad(divergence), (parameters,), (vector,))[1]


def trust_region_step(
    parameters: Parameters,
    gain: Callable[[Parameters], jax.Array],
    divergence: Callable[[Parameters], jax.Array],
    curvature: Callable[[Parameters], jax.Array],
    *,
    max_divergence: float,
    iterations: int,
    damping: float,
    num_backtracks: int,
) -> tuple[Parameters, dict[str, jax.Array]]:
    """Take the longest natural gradient step that the trust region allows.

        x ≈ (F + c I)^(−1) g,   step = x √(2 d / xᵀ(F + c I)x)

    x is found by conjugate gradients. The step is halved until the gain is no smaller and the
    divergence is within :data:`DIVERGENCE_SLACK` times its bound. If that never happens, the
    parameters stay.

    Args:
        parameters: any pytree.
        gain: the function of the parameters to maximise; g is its gradient.
        divergence: of other parameters from ``parameters``.
        curvature: the divergence estimated from fewer samples; F is its Hessian.
        max_divergence: d, in nats.
        iterations: of conjugate gradients.
        damping: c.
        num_backtracks: how many lengths are tried.
    """
    flat, unravel = ravel_pytree(parameters)
    before, gradient = jax.value_and_grad(lambda x: gain(unravel(x)))(flat)

    def matrix(vector: jax.Array) -> jax.Array:
        product = fisher_product(lambda x: curvature(unravel(x)), flat, vector)
        return product + damping * vector

    # The gradient's own scale is arbitrary: without a tolerance relative to it, it would matter.
    direction, _ = cg(matrix, gradient, tol=1e-5, maxiter=iterations)
    length = jnp.sqrt(2.0 * max_divergence / jnp.maximum(direction @ matrix(direction), 1e-12))

    def rejected(carry: Any) -> jax.Array:
        attempt, _, _, accepted = carry
        return ~accepted & (attempt < num_backtracks)

    def halve(carry: Any) -> Any:
        attempt, *_ = carry
        candidate = flat + 0.5**attempt * length * direction
        moved = divergence(unravel(candidate))
        # Both comparisons are false for NaN.
        within = moved <= DIVERGENCE_SLACK * max_divergence
        accepted = (gain(unravel(candidate)) >= before) & within
        return attempt + 1, candidate, moved, accepted

    zero = jnp.zeros(())
    _, candidate, moved, accepted = jax.lax.while_loop(
        rejected, halve, (jnp.zeros((), jnp.int32), flat, zero, jnp.zeros((), bool))
    )
    metrics = {"divergence": jnp.where(accepted, moved, 0.0)}
    return unravel(jnp.where(accepted, candidate, flat)), metrics
