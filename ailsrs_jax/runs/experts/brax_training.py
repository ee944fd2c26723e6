"""What Brax's trainers share: arguments, actions from −1 to 1, and reports on their progress."""

import contextlib
import dataclasses
import time
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from brax.envs.wrappers import training as wrappers

from ailsrs_jax.components.policy import MlpPolicy
from ailsrs_jax.data.policies import SavedPolicy
from ailsrs_jax.envs import Env, State, Wrapper
from ailsrs_jax.envs.divergence import EndDiverged
from ailsrs_jax.envs.interface import action_range
from ailsrs_jax.runs.storage.metrics import IterationReport


def shared_arguments(env: Env, settings: Any, seed: int) -> dict[str, Any]:
    """Return the arguments that ``train`` of PPO and of the evolution strategy both take."""
    return {
        "environment": UnitActions(EndDiverged(env)),
        "wrap_env_fn": wrappers.wrap,
        "max_devices_per_host": 1,
        "num_timesteps": settings.num_env_steps,
        "num_evals": settings.num_evaluations + 1,  # Brax also evaluates before it trains
        "episode_length": settings.episode_length,
        "learning_rate": settings.learning_rate,
        "normalize_observations": True,
        "seed": seed,
    }


@dataclasses.dataclass
class Progress:
    """Counts and times the parts of a training, one for each evaluation."""

    num_iterations: int
    iteration: int = 0
    num_steps: int = 0
    started: float = dataclasses.field(default_factory=time.perf_counter)

    @contextlib.contextmanager
    def report(self, num_steps: int, metrics: dict[str, Any]) -> Iterator[IterationReport]:
        """Report the part that ends after ``num_steps`` steps in all, then begin the next part."""
        metrics = metrics | {"env_steps": num_steps}
        seconds = time.perf_counter() - self.started
        yield IterationReport(
            iteration=self.iteration,
            num_iterations=self.num_iterations,
            metrics={name: np.array([value]) for name, value in metrics.items()},
            seconds=seconds,
            env_steps_per_second=(num_steps - self.num_steps) / seconds,
            compile_seconds=None,  # Brax compiles during the first part
        )
        self.iteration, self.num_steps = self.iteration + 1, num_steps
        self.started = time.perf_counter()


class UnitActions(Wrapper):
    """Clips actions to −1 to 1, and stretches them to the range of the environment."""

    def step(self, state: State, action: jax.Array) -> State:
        """Take a step with ``action (p,)``; −1 and 1 are the ends of each range."""
        middle, half_range = _stretch(self.env)
        return self.env.step(state, middle + half_range * jnp.clip(action, -1.0, 1.0))


def unit_policy(
    env: Env, normalizer: Any, layers: Sequence[Mapping[str, jax.Array]], action_std: jax.Array
) -> MlpPolicy:
    """Convert a policy that Brax trained on ``UnitActions(env)`` to one for ``env``.

    ``normalizer`` holds the statistics of observations. Each layer has a ``kernel (in, out)`` and a
    ``bias (out,)``. ``action_std (p,)`` is that of the Gaussian, for actions from −1 to 1.
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


def unit_layers(env: Env, policy: SavedPolicy) -> tuple[list[dict[str, jax.Array]], jax.Array]:
    """Return ``layers`` and ``action_std`` of which :func:`unit_policy` makes ``policy``."""
    middle, half_range = _stretch(env)
    *hidden, (weights, bias) = policy.layers
    layers = *hidden, (weights / half_range[:, None], (bias - middle) / half_range)
    named = [{"kernel": jnp.asarray(w).T, "bias": jnp.asarray(b)} for w, b in layers]
    return named, jnp.asarray(policy.noise_std) / half_range


def _stretch(env: Env) -> tuple[jax.Array, jax.Array]:
    """Return the middle and half the width of the actions' range, each ``(p,)``."""
    low, high = action_range(env)
    return (high + low) / 2.0, (high - low) / 2.0
