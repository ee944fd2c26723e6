"""Neural experts: Brax's proximal policy optimization on our environments."""

import contextlib
import dataclasses
import functools
import time
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from brax.envs.wrappers import training as wrappers
from brax.training.agents.ppo import networks, train

from ailsrs_jax.components.policy import MlpPolicy, repeated
from ailsrs_jax.envs import Env
from ailsrs_jax.envs.divergence import EndDiverged
from ailsrs_jax.errors import UserError
from ailsrs_jax.runs.experts.unit_actions import UnitActions, unit_policy
from ailsrs_jax.runs.storage.metrics import IterationReport
from ailsrs_jax.trainers.parts.rollout import simulate
from ailsrs_jax.trainers.parts.settings import Positive, Signed, UpToOne


@dataclasses.dataclass(frozen=True)
class PpoSettings:
    """Settings of :func:`train_ppo`, under Brax's names."""

    num_env_steps: int = 5_000_000
    num_evaluations: int = 50
    num_evaluation_episodes: int = 32
    episode_length: int = 1000
    num_envs: int = 32
    unroll_length: int = 128  #: steps of an environment in a batch
    num_minibatches: int = 16  #: of num_envs / num_minibatches environments each
    num_updates_per_batch: int = 10
    learning_rate: Positive = 3e-4
    entropy_cost: float = 0.0
    discounting: UpToOne = 0.995
    gae_lambda: UpToOne = 0.98
    clipping_epsilon: float = 0.2
    reward_scaling: float = 0.1
    hidden_size: int = 64  #: tanh units in each of two layers
    init_noise_std: Positive = 1.0  #: of the Gaussian, in halves of the actions' range
    stop_at: Signed = 0.0  #: return at which to stop, keeping what is nearest to it; 0: never


class _StopError(Exception):
    """Ends Brax's training from within its callback."""


# To the returns of the paper's experts; and beyond on Walker2d, where the paper's is a weak one.
PPO_PRESETS = {
    # Noise costs Ant more than walking earns, until it is less.
    "Ant-v5": PpoSettings(
        num_env_steps=4_300_800,
        num_evaluations=42,
        num_evaluation_episodes=16,
        init_noise_std=0.35,
    ),
    "HalfCheetah-v5": PpoSettings(
        num_env_steps=8_000_000, num_evaluations=160, num_evaluation_episodes=64, stop_at=4632.0
    ),
    "Hopper-v5": PpoSettings(stop_at=3245.0, num_evaluations=100),
    # As Ant. A shorter horizon is enough not to fall, and the reward is mostly for that.
    "Humanoid-v5": PpoSettings(
        num_env_steps=4_096_000,
        num_evaluations=20,
        num_evaluation_episodes=16,
        discounting=0.97,
        gae_lambda=0.95,
        init_noise_std=0.35,
    ),
    "Walker2d-v5": PpoSettings(num_env_steps=3_000_000),
}


def train_ppo(
    env: Env,
    settings: PpoSettings,
    seed: int,
    consider: Callable[[IterationReport, MlpPolicy, float], None],
) -> None:
    """Train a Gaussian policy on the reward of ``env``.

    Args:
        env: the environment.
        settings: the settings.
        seed: random seed.
        consider: called after each part of the training, with what there is to report, the mean of
            the Gaussian policy, and how good it is, higher being better.

    Raises:
        UserError: the minibatches cannot have the same number of environments.
    """
    if settings.num_envs % settings.num_minibatches:
        raise UserError(
            f"setting num_envs is {settings.num_envs}: it must be a multiple of num_minibatches, "
            f"{settings.num_minibatches}"
        )
    evaluate = jax.jit(functools.partial(_evaluate, env, settings))
    steps_done, iteration, started = 0, 0, time.perf_counter()

    def evaluated(num_steps: int, _: Any, parameters: Any) -> None:
        nonlocal steps_done, iteration, started
        if num_steps == 0:  # nothing has been trained yet
            return
        policy = _policy(env, parameters)
        episodes = evaluate(policy, jax.random.key(iteration))
        mean = float(episodes.env_returns.mean())
        metrics = {
            "evaluation_return": mean,
            "evaluation_length": float(episodes.lengths.mean()),
            **jax.device_get(episodes.counts()),
            "env_steps": num_steps,
        }
        seconds = time.perf_counter() - started
        report = IterationReport(
            iteration=iteration,
            num_iterations=settings.num_evaluations,
            metrics={name: np.array([value]) for name, value in metrics.items()},
            seconds=seconds,
            env_steps_per_second=(num_steps - steps_done) / seconds,
            compile_seconds=None,  # Brax compiles within the first part
        )
        score = mean
        if settings.stop_at:  # a mean at the level can be of good episodes and of falls
            score = -float(jnp.sqrt(jnp.mean((episodes.env_returns - settings.stop_at) ** 2)))
        consider(report, policy, score)
        if settings.stop_at and mean >= settings.stop_at:
            raise _StopError
        steps_done, iteration, started = num_steps, iteration + 1, time.perf_counter()

    with contextlib.suppress(_StopError):
        train.train(
            environment=UnitActions(EndDiverged(env)),
            wrap_env_fn=wrappers.wrap,
            max_devices_per_host=1,
            num_timesteps=settings.num_env_steps,
            num_evals=settings.num_evaluations + 1,
            run_evals=False,  # the reports above are ours
            num_resets_per_eval=1,
            num_envs=settings.num_envs,
            episode_length=settings.episode_length,
            unroll_length=settings.unroll_length,
            batch_size=settings.num_envs // settings.num_minibatches,
            num_minibatches=settings.num_minibatches,
            num_updates_per_batch=settings.num_updates_per_batch,
            learning_rate=settings.learning_rate,
            entropy_cost=settings.entropy_cost,
            discounting=settings.discounting,
            gae_lambda=settings.gae_lambda,
            clipping_epsilon=settings.clipping_epsilon,
            reward_scaling=settings.reward_scaling,
            normalize_observations=True,
            network_factory=functools.partial(
                networks.make_ppo_networks,
                policy_hidden_layer_sizes=(settings.hidden_size,) * 2,
                value_hidden_layer_sizes=(settings.hidden_size,) * 2,
                activation=jnp.tanh,
                distribution_type="normal",
                noise_std_type="log",
                init_noise_std=settings.init_noise_std,
                mean_kernel_init_fn=jax.nn.initializers.orthogonal,
                mean_kernel_init_kwargs={"scale": 0.01},
            ),
            policy_params_fn=evaluated,
            seed=seed,
        )


def _policy(env: Env, parameters: Any) -> MlpPolicy:
    normalizer, policy, *_ = parameters
    network = policy["params"]
    hidden = network["MLP_0"]
    layers = [*(hidden[f"hidden_{i}"] for i in range(len(hidden))), network["Dense_0"]]
    return unit_policy(env, normalizer, layers, jnp.exp(network["std_logparam"]["log_value"]))


def _evaluate(env: Env, settings: PpoSettings, policy: MlpPolicy, key: jax.Array) -> Any:
    num_episodes = settings.num_evaluation_episodes
    policies = repeated(policy, num_episodes)
    return simulate(env, policies, jax.random.split(key, num_episodes), settings.episode_length)
