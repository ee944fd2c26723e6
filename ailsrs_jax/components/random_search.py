"""Basic and augmented random search (Mania, Guy and Recht, 2018) as pure functions.

One step of the search is ``weights = step(weights, deltas, returns_plus, returns_minus, ...)``,
where the returns are those of the policies :func:`perturb` made. The paper's four algorithms are
settings of it: BRS has ``scale_by_std=False``; V1 and V2 scale (V2 also standardises the
observations, which is the policy's business); the ``-t`` variants have
``num_top_directions < num_directions``.
"""

import jax
import jax.numpy as jnp


def sample_directions(key: jax.Array, num_directions: int, shape: tuple[int, ...]) -> jax.Array:
    """Draw ``deltas (N, *shape)``, independent standard normal numbers."""
    return jax.random.normal(key, (num_directions, *shape))


def perturb(weights: jax.Array, deltas: jax.Array, noise_std: float | jax.Array) -> jax.Array:
    """The 2N perturbed weights: ``M + ν δ_i`` for all i, then ``M − ν δ_i`` for all i."""
    return jnp.concatenate([weights + noise_std * deltas, weights - noise_std * deltas])


def step(
    weights: jax.Array,
    deltas: jax.Array,
    returns_plus: jax.Array,
    returns_minus: jax.Array,
    *,
    step_size: float | jax.Array,
    num_top_directions: int,
    scale_by_std: bool = True,
) -> jax.Array:
    """Move the weights along the directions that paid.

        M + α / (b σ_R) Σ_{i in the b directions with the largest max(r⁺_i, r⁻_i)} (r⁺_i − r⁻_i) δ_i

    Args:
        weights: ``(p, n)``.
        deltas: ``(N, p, n)`` unit noise.
        returns_plus: ``(N,)`` returns of ``M + ν δ_i``.
        returns_minus: ``(N,)`` returns of ``M − ν δ_i``.
        step_size: α.
        num_top_directions: b; of equal directions the first are kept, so exactly b are used.
        scale_by_std: divide by σ_R, the standard deviation of the 2b returns used. Where all of
            them are equal there is nothing to learn and the weights stay.
    """
    _, top = jax.lax.top_k(jnp.maximum(returns_plus, returns_minus), num_top_directions)
    returns_plus, returns_minus, deltas = returns_plus[top], returns_minus[top], deltas[top]
    gradient = jnp.einsum("i,i...->...", returns_plus - returns_minus, deltas)
    if scale_by_std:
        std = jnp.std(jnp.concatenate([returns_plus, returns_minus]))
        gradient = jnp.where(std > 0, gradient / jnp.where(std > 0, std, 1.0), 0.0)
    return weights + step_size / num_top_directions * gradient
