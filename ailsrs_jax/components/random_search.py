"""Basic and augmented random search (Mania, Guy and Recht, 2018) as pure functions.

One step of the search is ``weights = step(weights, deltas, returns_plus, returns_minus, ...)``. The
returns are those of the policies that :func:`perturb` makes, NaN for a policy that diverged. The
paper's four algorithms are settings of this step. BRS has ``scale_by_std=False``; V1 and V2 scale,
and the policy of V2 also standardises observations. The ``-t`` variants have
``num_top_directions < num_directions``.
"""

import jax
import jax.numpy as jnp

from ailsrs_jax.components.finite import finite_or

# A standard deviation below this fraction of the returns is rounding in float32.
MIN_RELATIVE_STD = 1e-6


def perturb(weights: jax.Array, deltas: jax.Array, noise_std: float | jax.Array) -> jax.Array:
    """Return the 2N perturbed weights: all ``M + ν δ_i``, then all ``M − ν δ_i``."""
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
    """Move the weights along the directions with the highest returns.

        M + α / (b σ_R) Σ_{i in the b directions with the largest max(r⁺_i, r⁻_i)} (r⁺_i − r⁻_i) δ_i

    Args:
        weights: ``(p, n)``.
        deltas: ``(N, p, n)`` unit noise.
        returns_plus: ``(N,)`` returns of ``M + ν δ_i``. A return that is not finite is ranked last
            and counts as the lowest finite one, so the step leads away from its policy.
        returns_minus: ``(N,)`` returns of ``M − ν δ_i``.
        step_size: α.
        num_top_directions: b; 0 stands for all. The first of equal directions are kept, so exactly
            b are used.
        scale_by_std: divide by σ_R, the standard deviation of the 2b returns used. If they differ
            by no more than rounding, the weights stay.

    Returns:
        The new weights; the old ones if new ones are not finite.
    """
    num_used = num_top_directions or len(deltas)
    pairs = jnp.stack([returns_plus, returns_minus])
    finite = jnp.isfinite(pairs)
    # NaN would be ranked first.
    _, top = jax.lax.top_k(jnp.max(jnp.where(finite, pairs, -jnp.inf), 0), num_used)
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
    return finite_or(weights + step_size / num_used * gradient, weights)
