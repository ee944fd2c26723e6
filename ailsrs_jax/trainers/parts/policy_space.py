"""The policies that a random search can reach."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np

from ailsrs_jax.components.linear_regression import affine_regression, ridge_regression
from ailsrs_jax.components.normalizer import RunningStatistics
from ailsrs_jax.components.policy import LinearPolicy, Policy
from ailsrs_jax.envs import Env
from ailsrs_jax.envs.interface import action_range
from ailsrs_jax.trainers.parts.ailsrs_settings import AilsrsSettings
from ailsrs_jax.trainers.parts.reference import Reference
from ailsrs_jax.trainers.parts.settings import parse_entries


@dataclasses.dataclass(frozen=True, eq=False)
class PolicySpace:
    """Linear policies of ``env`` with weights ``(p, n + 1)``; the last column is the intercept."""

    env: Env
    settings: AilsrsSettings
    reference: Reference

    @property
    def shape(self) -> tuple[int, int]:
        """``(p, n + 1)``."""
        return self.env.action_size, self.env.observation_size + 1

    @property
    def searched(self) -> np.ndarray:
        """``(n + 1,)``, 1 for the entries that the policy sees and for its intercept, else 0."""
        first, end = parse_entries(self.settings.policy_entries, self.env.observation_size)
        searched = np.zeros(self.shape[1], np.float32)
        searched[first:end], searched[-1] = 1.0, self.settings.intercept
        return searched

    def clone(self) -> jax.Array:
        """Return the weights ``(p, n + 1)`` of a clone of the expert."""
        expert = self.reference
        observations = expert.observations * self.searched[:-1]
        if self.settings.intercept:
            return affine_regression(observations, expert.actions, expert.alive)
        weights = ridge_regression(observations, expert.actions, expert.alive)
        return jnp.pad(weights, [(0, 0), (0, 1)])

    def policy(self, weights: jax.Array, statistics: RunningStatistics) -> LinearPolicy:
        """Return the policy of ``weights (p, n + 1)``, with the statistics frozen as they are."""
        standard = statistics.mean, statistics.std, *action_range(self.env)
        return LinearPolicy(weights[:, :-1], *standard, intercept=weights[:, -1])

    def weights(self, policy: Policy) -> jax.Array:
        """Return the weights ``(p, n + 1)`` of a policy that :meth:`policy` returned."""
        matrices, biases = policy.layers
        return jnp.column_stack([matrices[-1], biases[-1]])
