"""Actions from −1 to 1, as Brax's trainers have them, and the policies that give them."""

from collections.abc import Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
from brax.envs.base import Wrapper

from ailsrs_jax.components.policy import MlpPolicy
from ailsrs_jax.envs import Env, State
from ailsrs_jax.envs.interface import action_range


class UnitActions(Wrapper):
    """Stretches actions from −1 to 1, to which a policy's are clipped, to their range."""

    def step(self, state: State, action: jax.Array) -> State:
        """One step with ``action (p,)``, −1 and 1 being the ends of each range."""
        middle, half_range = _stretch(self.env)
        return self.env.step(state, middle + half_range * jnp.clip(action, -1.0, 1.0))


def unit_policy(
    env: Env,
    normalizer: Any,
    layers: Sequence[Mapping[str, jax.Array]],
    action_std: jax.Array,
) -> MlpPolicy:
    """A policy that Brax trained on ``UnitActions(env)``, as one for ``env`` itself.

    Args:
        env: the environment.
        normalizer: Brax's running statistics of observations.
        layers: ``kernel (in, out)`` and ``bias (out,)`` of each.
        action_std: ``(p,)`` of the Gaussian, in halves of the actions' range.
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
    """Middle and half of the actions' range, ``(p,)`` each."""
    low, high = action_range(env)
    return (high + low) / 2.0, (high - low) / 2.0
