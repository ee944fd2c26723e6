"""The policies that a random search can reach."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import optax

from ailsrs_jax.components.linear_regression import affine_regression, ridge_regression
from ailsrs_jax.components.normalizer import RunningStatistics
from ailsrs_jax.components.policy import Layers, LinearPolicy, MlpPolicy, Policy, hidden_units
from ailsrs_jax.envs import Env
from ailsrs_jax.envs.interface import action_range
from ailsrs_jax.trainers.parts.ailsrs_settings import AilsrsSettings
from ailsrs_jax.trainers.parts.network_clone import clone_network, draw_layers
from ailsrs_jax.trainers.parts.reference import Reference
from ailsrs_jax.trainers.parts.settings import parse_entries

HIDDEN_SIZES = (64, 64)  # tanh units of a network
CLONING_STEPS = 20_000  # of Adam
CLONING_RATE = 1e-3  # its first learning rate; it falls to 0


@dataclasses.dataclass(frozen=True, eq=False)
class PolicySpace:
    """Policies of ``env`` that are affine in m features, with searched weights ``(p, m + 1)``.

    The last column is the intercept. A linear policy's features are the n entries of the
    observation. Those of a network are the units of its last hidden layer, and its hidden layers
    do not change.
    """

    env: Env
    settings: AilsrsSettings
    reference: Reference

    @property
    def shape(self) -> tuple[int, int]:
        """``(p, m + 1)``."""
        return self.env.action_size, len(self.searched)

    @property
    def searched(self) -> np.ndarray:
        """``(m + 1,)``, 1 for the features that are used and for the intercept, else 0."""
        is_linear = self.settings.policy == "linear"
        used = self._seen if is_linear else np.ones(HIDDEN_SIZES[-1], np.float32)
        return np.append(used, np.float32(self.settings.intercept))

    @property
    def _seen(self) -> np.ndarray:
        """``(n,)``, 1 for the entries of an observation that the policy sees, else 0."""
        first, end = parse_entries(self.settings.policy_entries, self.env.observation_size)
        seen = np.zeros(self.env.observation_size, np.float32)
        seen[first:end] = 1.0
        return seen

    def hidden_layers(self, key: jax.Array) -> Layers:
        """Return the hidden layers of a cloned network; a linear policy has none."""
        if self.settings.policy == "linear":
            return (), ()
        sizes = (self.env.observation_size, *HIDDEN_SIZES, self.env.action_size)
        draw_key, clone_key = jax.random.split(key)
        (weights, biases), _ = clone_network(
            draw_layers(draw_key, sizes),
            jnp.zeros(self.env.action_size),
            self.reference.replace(observations=self.reference.observations * self._seen),
            clone_key,
            num_steps=CLONING_STEPS,
            learning_rate=optax.cosine_decay_schedule(CLONING_RATE, CLONING_STEPS),
        )
        first, *others = weights[:-1]
        return (first * self._seen, *others), biases[:-1]

    def clone(self, hidden: Layers) -> jax.Array:
        """Return the weights ``(p, m + 1)`` of a clone of the expert."""
        expert = self.reference
        features = hidden_units(*hidden, expert.observations) * self.searched[:-1]
        if self.settings.intercept:
            return affine_regression(features, expert.actions, expert.alive)
        weights = ridge_regression(features, expert.actions, expert.alive)
        return jnp.pad(weights, [(0, 0), (0, 1)])

    def policy(self, weights: jax.Array, hidden: Layers, statistics: RunningStatistics) -> Policy:
        """Return the policy of ``weights (p, m + 1)``, with the statistics frozen as they are."""
        standard = statistics.mean, statistics.std, *action_range(self.env)
        matrix, bias = weights[:, :-1], weights[:, -1]
        if not hidden[0]:
            return LinearPolicy(matrix, *standard, intercept=bias)
        layers = (*hidden[0], matrix), (*hidden[1], bias)
        return MlpPolicy(*layers, *standard, action_std=jnp.zeros_like(bias))

    def weights(self, policy: Policy) -> jax.Array:
        """Return the weights ``(p, m + 1)`` of a policy that :meth:`policy` returned."""
        matrices, biases = policy.layers
        return jnp.column_stack([matrices[-1], biases[-1]])
