"""Basic and augmented random search (Mania, Guy and Recht, 2018) as pure functions.

One step of the search is ``weights = step(weights, deltas, returns_plus, returns_minus, ...)``,
where the returns are those of the policies :func:`perturb` made, NaN where they diverged. The
paper's four algorithms are settings of it: BRS has ``scale_by_std=False``; V1 and V2 scale (V2 also
standardises the observations, which is the policy's business); the ``-t`` variants have
``num_top_directions < num_directions``.
"""

import jax
import jax.numpy as jnp

from ailsrs_jax.components.finite import finite_or

# Below this, relative to the returns, their standard deviation in float32 is rounding.
MIN_RELATIVE_STD = 1e-6


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
        returns_plus: ``(N,)`` returns of ``M + ν δ_i``. One that is not finite is ranked last, and
            counts as the lowest of those that are; so a step leads away from where it came from.
        returns_minus: ``(N,)`` returns of ``M − ν δ_i``.
        step_size: α.
        num_top_directions: b; of equal directions the first are kept, so exactly b are used.
        scale_by_std: divide by σ_R, the standard deviation of the 2b returns used. Where they
            differ by no more than rounding there is nothing to learn and the weights stay.

    Returns:
        The weights, finite if they were: a step that is not is not taken.
    """
    pairs = jnp.stack([returns_plus, returns_minus])
    finite = jnp.isfinite(pairs)
    # NaN would come first.
    _, top = jax.lax.top_k(jnp.max(jnp.where(finite, pairs, -jnp.inf), 0), num_top_directions)
    lowest = jnp.min(pairs, where=finite, initial=jnp.inf)
    pairs = jnp.where(finite, pairs, jnp.where(finite.any(), lowest, 0.0))
    (returns_plus, returns_minus), deltas = pairs[:, top], deltas[top]
    differences = returns_plus - returns_minus
    gradient = jnp.einsum("i,i...->...", differences, deltas, precision="highest")  # not TF32
    if scale_by_std:
        used = jnp.concatenate([returns_plus, returns_minus])
        std = jnp.std(used)
        differ = std > MIN_RELATIVE_STD * jnp.max(jnp.abs(used))
        gradient = jnp.where(differ, gradient / jnp.where(differ, std, 1.0), 0.0)
    return finite_or(weights + step_size / num_top_directions * gradient, weights)
