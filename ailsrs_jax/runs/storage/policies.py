"""Policies of a training state, as they are saved."""

import dataclasses

import jax
import numpy as np

from ailsrs_jax.components.policy import LinearPolicy, Policy
from ailsrs_jax.data.policies import SavedLinearPolicy, SavedMlpPolicy, SavedPolicy
from ailsrs_jax.runs.storage.config import RunConfig

EVALUATED = "iterations"  # the folder, beside policy.npz, of policies of single iterations
LARGEST_SHIFT = 1e3  # of the mean, in standard deviations
# The iterations whose policies are stored: 0, 1, 2, 3, 4, 6, 8, 12, 16, 24, and so on. A run learns
# most at its start, and these are few enough to store networks, too.
MILESTONES = {0, 1} | {start << doubled for doubled in range(30) for start in (2, 3)}


def saved_policy(policy: Policy, env_id: str) -> SavedPolicy:
    """Return ``policy`` as NumPy arrays that can be saved.

    An intercept b shifts the mean: M diag(Σ)^(−1/2) (s − μ') = M diag(Σ)^(−1/2) (s − μ) + b for
    μ' = μ − diag(Σ)^(1/2) M⁺ b, if the rows of M are independent. If they are not, or if the shift
    is so large that float32 would lose s − μ' in it, the policy is saved as a perceptron of one
    layer.
    """
    fields = vars(jax.tree.map(np.asarray, policy))
    if not isinstance(policy, LinearPolicy):
        return SavedMlpPolicy(**fields, env_id=env_id)
    weights, intercept = fields["weights"], fields.pop("intercept")
    if intercept is not None and intercept.any():
        shift = np.linalg.pinv(weights.astype(float)) @ intercept
        exact = np.allclose(weights @ shift, intercept, rtol=1e-4, atol=1e-4)
        if not exact or np.abs(shift).max() > LARGEST_SHIFT:
            layer = {"weights": (weights,), "biases": (intercept,)}
            still = np.zeros_like(intercept)
            return SavedMlpPolicy(**(fields | layer), action_std=still, env_id=env_id)
        fields["mean"] = fields["mean"] - fields["std"] * shift
    return SavedLinearPolicy(**fields, env_id=env_id)


def by_seed(policies: Policy, config: RunConfig) -> dict[int, SavedPolicy]:
    """Return the policy of each seed, from ``policies`` with a leading axis for all seeds."""
    policies = jax.tree.map(np.asarray, policies)

    def of_lane(index: int) -> SavedPolicy:
        policy = saved_policy(jax.tree.map(lambda x: x[index], policies), config.env_id)
        return dataclasses.replace(policy, episode_length=config.settings.episode_length)

    return {seed: of_lane(index) for index, seed in enumerate(config.seeds)}
