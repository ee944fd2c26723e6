"""Actions from −1 to 1, which Brax's trainers expect, and the policies trained with them."""

from collections.abc import Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
from brax.envs.base import Wrapper

from ailsrs_jax.components.policy import MlpPolicy
from ailsrs_jax.envs import Env, State
from ailsrs_jax.envs.interface import action_range


class UnitActions(Wrapper):
    """Clips actions to −1 to 1, and stretches them to the range of the environment."""

    def step(self, state: State, action: jax.Array) -> State:
        """Take a step with ``action (p,)``; −1 and 1 are the ends of each range."""
        middle, half_range = _stretch(self.env)
        return self.env.step(state, middle + half_range * jnp.clip(action, -1.0, 1.0))


def unit_policy(
    env: Env,
    normalizer: Any,
    layers: Sequence[Mapping[str, jax.Array]],
    action_std: jax.Array,
) -> MlpPolicy:
    """Convert a policy that Brax trained on ``UnitActions(env)`` to one for ``env``.

    Args:
        env: the environment.
        normalizer: Brax's running statistics of observations.
        layers: the ``kernel (in, out)`` and ``bias (out,)`` of each layer.
        action_std: standard deviation ``(p,)`` of the Gaussian, for actions from −1 to 1.
    """
    middle, half_range = _stretch(env)
    weights, biases = zip(*((layer["kernel"].T, layer["bias"]) for layer in layers), strict=True)
    low, high = action_range(env)
    return MlpPolicy(
        weights=(*weights[:-1], half_range[:, None] * weights[-1]),
        biases=(*biases[:-1], middle + half_range * biases[-1]),
        mean=normalizer.mean,
        std=normalizer.std,
        action_low=low,
        action_high=high,
        action_std=half_range * action_std,
    )


def _stretch(env: Env) -> tuple[jax.Array, jax.Array]:
    """Return the middle and half the width of the actions' range, each ``(p,)``."""
    low, high = action_range(env)
    return (high + low) / 2.0, (high - low) / 2.0
