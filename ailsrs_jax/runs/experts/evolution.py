"""Neural experts where PPO finds none: Brax's evolution strategy on our environments."""

import dataclasses
import functools
import time
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from brax.envs.wrappers import training as wrappers
from brax.training.agents.es import networks, train
from brax.training.networks import make_policy_network

from ailsrs_jax.components.policy import MlpPolicy
from ailsrs_jax.envs import Env
from ailsrs_jax.envs.wrappers import EndDiverged
from ailsrs_jax.runs.experts.unit_actions import UnitActions, unit_policy
from ailsrs_jax.runs.storage.metrics import IterationReport
from ailsrs_jax.trainers.parts.settings import Positive


@dataclasses.dataclass(frozen=True)
class EvolutionSettings:
    """Settings of :func:`train_by_evolution`; random search's names for what it shares with it."""

    num_env_steps: int = 4_800_000
    num_evaluations: int = 30
    num_evaluation_episodes: int = 8
    episode_length: int = 1000
    num_directions: int = 16
    noise_std: Positive = 0.05
    learning_rate: Positive = 0.02
    hidden_size: int = 64  #: tanh units in each of two layers


class _Deterministic:
    """The network's output is the action: random search needs no other noise than its own."""

    def sample(self, output: jax.Array, _: jax.Array) -> jax.Array:
        return output

    def mode(self, output: jax.Array) -> jax.Array:
        return output


def train_by_evolution(
    env: Env, settings: EvolutionSettings, seed: int, watch: Callable[[IterationReport], None]
) -> tuple[MlpPolicy, float]:
    """Train a policy on the reward of ``env``, by the ranks of whole episodes' returns.

    An evolution strategy (Salimans et al., 2017) discounts nothing. On Swimmer a stroke pays so
    late that PPO settles for half of what can be had.

    Args:
        env: the environment.
        settings: the settings.
        seed: random seed.
        watch: called after each part of the training with what there is to report.

    Returns:
        The last policy, the only one that Brax hands out, and its return.
    """
    steps_done, iteration, started = 0, 0, time.perf_counter()

    def evaluated(num_steps: int, metrics: dict[str, Any]) -> None:
        nonlocal steps_done, iteration, started
        if num_steps == 0:  # nothing has been trained yet
            return
        reported = {
            "evaluation_return": metrics["eval/episode_reward"],
            "evaluation_length": metrics["eval/avg_episode_length"],
            "env_steps": num_steps,
        }
        seconds = time.perf_counter() - started
        report = IterationReport(
            iteration=iteration,
            num_iterations=settings.num_evaluations,
            metrics={name: np.array([value]) for name, value in reported.items()},
            seconds=seconds,
            env_steps_per_second=(num_steps - steps_done) / seconds,
            compile_seconds=None,  # Brax compiles within the first part
        )
        watch(report)
        steps_done, iteration, started = num_steps, iteration + 1, time.perf_counter()

    _, (normalizer, parameters), metrics = train.train(
        environment=UnitActions(EndDiverged(env)),
        wrap_env_fn=wrappers.wrap,
        max_devices_per_host=1,
        num_timesteps=settings.num_env_steps,
        num_evals=settings.num_evaluations + 1,
        num_eval_envs=settings.num_evaluation_episodes,
        deterministic_eval=True,
        episode_length=settings.episode_length,
        population_size=settings.num_directions,
        perturbation_std=settings.noise_std,
        learning_rate=settings.learning_rate,
        fitness_shaping=train.FitnessShaping.CENTERED_RANK,
        normalize_observations=True,
        network_factory=functools.partial(_network, settings.hidden_size),
        progress_fn=evaluated,
        seed=seed,
    )
    hidden = parameters["params"]
    layers = [hidden[f"hidden_{i}"] for i in range(len(hidden))]
    policy = unit_policy(env, normalizer, layers, jnp.zeros(env.action_size))
    return policy, float(metrics["eval/episode_reward"])


def _network(
    hidden_size: int,
    observation_size: int,
    action_size: int,
    preprocess_observations_fn: Callable[..., jax.Array],
) -> networks.ESNetworks:
    return networks.ESNetworks(
        policy_network=make_policy_network(
            action_size,
            observation_size,
            preprocess_observations_fn=preprocess_observations_fn,
            hidden_layer_sizes=(hidden_size,) * 2,
            activation=jnp.tanh,
        ),
        parametric_action_distribution=_Deterministic(),
    )
