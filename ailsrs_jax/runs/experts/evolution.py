"""Brax's evolution strategy, for tasks on which PPO finds no good expert."""

import dataclasses
import types
from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
from brax.training.agents.es import networks, train
from brax.training.networks import make_policy_network

from ailsrs_jax.components.policy import MlpPolicy
from ailsrs_jax.envs import Env
from ailsrs_jax.runs.experts.brax_training import Progress, shared_arguments, unit_policy
from ailsrs_jax.runs.storage.metrics import IterationReport
from ailsrs_jax.trainers.parts.settings import Positive


@dataclasses.dataclass(frozen=True)
class EvolutionSettings:
    """Settings of :func:`train_by_evolution`; those shared with random search have its names."""

    num_env_steps: int = 4_800_000
    num_evaluations: int = 30
    num_evaluation_episodes: int = 8
    episode_length: int = 1000
    num_directions: int = 16
    noise_std: Positive = 0.05
    learning_rate: Positive = 0.02
    hidden_size: int = 64  #: tanh units in each of two layers


# A distribution without noise, because the strategy perturbs the weights, not the actions.
DETERMINISTIC = types.SimpleNamespace(sample=lambda output, _: output, mode=lambda output: output)


def train_by_evolution(
    env: Env, settings: EvolutionSettings, seed: int, watch: Callable[[IterationReport], None]
) -> tuple[MlpPolicy, float]:
    """Train a policy on the reward of ``env``, by the ranks of whole episodes' returns.

    An evolution strategy (Salimans et al., 2017) does not discount rewards. On Swimmer a stroke
    pays off so late that PPO reaches only half of the return. ``watch`` is called after each part
    of the training. The result is the last policy, because Brax returns no earlier one, and its
    return.
    """
    progress = Progress(settings.num_evaluations)

    def evaluated(num_steps: int, metrics: dict[str, Any]) -> None:
        if num_steps == 0:  # nothing has been trained yet
            return
        measured = {
            "evaluation_return": metrics["eval/episode_reward"],
            "evaluation_length": metrics["eval/avg_episode_length"],
        }
        with progress.report(num_steps, measured) as report:
            watch(report)

    def network(
        observation_size: int, action_size: int, preprocess_observations_fn: Callable[..., Any]
    ) -> networks.ESNetworks:
        policy_network = make_policy_network(
            action_size,
            observation_size,
            preprocess_observations_fn=preprocess_observations_fn,
            hidden_layer_sizes=(settings.hidden_size,) * 2,
            activation=jnp.tanh,
        )
        return networks.ESNetworks(policy_network, DETERMINISTIC)

    _, (normalizer, parameters), metrics = train.train(
        **shared_arguments(env, settings, seed),
        num_eval_envs=settings.num_evaluation_episodes,
        deterministic_eval=True,
        population_size=settings.num_directions,
        perturbation_std=settings.noise_std,
        fitness_shaping=train.FitnessShaping.CENTERED_RANK,
        network_factory=network,
        progress_fn=evaluated,
    )
    layers = [parameters["params"][f"hidden_{i}"] for i in range(3)]
    policy = unit_policy(env, normalizer, layers, jnp.zeros(env.action_size))
    return policy, float(metrics["eval/episode_reward"])
