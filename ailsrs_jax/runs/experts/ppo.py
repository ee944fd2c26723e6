"""Brax's proximal policy optimization on our environments."""

import contextlib
import dataclasses
import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from brax.training.acme import running_statistics
from brax.training.agents.ppo import networks, train
from brax.training.types import UInt64

from ailsrs_jax.components.policy import MlpPolicy
from ailsrs_jax.data.policies import SavedPolicy, require_policy
from ailsrs_jax.envs import Env
from ailsrs_jax.envs.interface import env_sizes
from ailsrs_jax.errors import UserError
from ailsrs_jax.runs.experts.brax_training import (
    Progress,
    shared_arguments,
    unit_layers,
    unit_policy,
)
from ailsrs_jax.runs.storage.metrics import IterationReport
from ailsrs_jax.trainers.parts.rollout import Simulator
from ailsrs_jax.trainers.parts.settings import Positive, Signed, UpToOne


@dataclasses.dataclass(frozen=True)
class PpoSettings:
    """Settings of :func:`train_ppo`, most of them under Brax's names."""

    num_env_steps: int = 5_000_000
    num_evaluations: int = 50
    num_evaluation_episodes: int = 32
    episode_length: int = 1000
    num_envs: int = 32
    unroll_length: int = 128  #: steps of each environment in a batch
    num_minibatches: int = 16  #: each has num_envs / num_minibatches environments
    num_updates_per_batch: int = 10
    learning_rate: Positive = 3e-4
    #: KL divergence from the policy that made the batch. While it is more than twice as large, the
    #: learning rate falls from learning_rate, and it rises again below half. 0: it is constant.
    desired_kl: float = 0.0
    entropy_cost: float = 0.0
    discounting: UpToOne = 0.995
    gae_lambda: UpToOne = 0.98
    clipping_epsilon: float = 0.2
    reward_scaling: float = 0.1
    hidden_size: int = 64  #: tanh units in each of two layers
    init_noise_std: Positive = 1.0  #: relative to half the range of an action
    stop_at: Signed = 0.0  #: stop at this return, and keep the policy nearest to it; 0: never


OBSERVED = 10_000_000  # steps that the statistics of a policy to go on from count as


class _StopError(Exception):
    """Raised in Brax's callback to end the training."""


# These reach the returns of the paper's experts. On Walker2d the paper's expert is weak, and this
# preset goes beyond it.
PPO_PRESETS = {
    # With more initial noise, Ant loses more by it than it earns by walking.
    "Ant-v5": PpoSettings(
        num_env_steps=10_649_600,
        num_evaluations=26,
        num_evaluation_episodes=64,
        num_envs=64,
        unroll_length=256,
        num_minibatches=32,
        desired_kl=0.01,
        init_noise_std=0.35,
    ),
    "HalfCheetah-v5": PpoSettings(
        num_env_steps=8_000_000, num_evaluations=160, num_evaluation_episodes=64, stop_at=4632.0
    ),
    "Hopper-v5": PpoSettings(stop_at=3245.0, num_evaluations=100),
    # The noise is as for Ant. Most of the reward is for not falling, which needs only a short
    # horizon.
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
    start: SavedPolicy | None,
    consider: Callable[[IterationReport, MlpPolicy, float], None],
) -> None:
    """Train a Gaussian policy on the reward of ``env``, from ``start`` or from a random one.

    ``consider`` is called after each part of the training with a report, the mean of the Gaussian
    policy, and its score. The policy with the highest score is the best.

    Raises:
        UserError: num_envs is not a multiple of num_minibatches, or ``start`` is another kind of
            policy.
    """
    if settings.num_envs % settings.num_minibatches:
        raise UserError(
            f"setting num_envs is {settings.num_envs}: it must be a multiple of num_minibatches, "
            f"{settings.num_minibatches}"
        )
    restored = None if start is None else _parameters(env, settings, start)
    sizes = settings.num_evaluation_episodes, settings.episode_length
    evaluate = jax.jit(lambda policy, key: Simulator(env).evaluate(policy, key, *sizes))
    progress = Progress(settings.num_evaluations)

    def evaluated(num_steps: int, _: Any, parameters: Any) -> None:
        if num_steps == 0:  # nothing has been trained yet
            return
        policy = _policy(env, parameters)
        episodes = evaluate(policy, jax.random.key(progress.iteration))
        mean = float(episodes.env_returns.mean())
        metrics = {
            "evaluation_return": mean,
            "evaluation_length": float(episodes.lengths.mean()),
            **jax.device_get(episodes.counts()),
        }
        score = mean
        if settings.stop_at:  # the distance of every episode, as good ones can make up for falls
            score = -float(jnp.sqrt(jnp.mean((episodes.env_returns - settings.stop_at) ** 2)))
        with progress.report(num_steps, metrics) as report:
            consider(report, policy, score)
        if settings.stop_at and mean >= settings.stop_at:
            raise _StopError

    with contextlib.suppress(_StopError):
        train.train(
            **shared_arguments(env, settings, seed),
            run_evals=False,  # evaluated() evaluates instead
            num_resets_per_eval=1,
            num_envs=settings.num_envs,
            unroll_length=settings.unroll_length,
            batch_size=settings.num_envs // settings.num_minibatches,
            num_minibatches=settings.num_minibatches,
            num_updates_per_batch=settings.num_updates_per_batch,
            learning_rate_schedule="ADAPTIVE_KL" if settings.desired_kl else None,
            learning_rate_schedule_max_lr=settings.learning_rate,
            desired_kl=settings.desired_kl,
            entropy_cost=settings.entropy_cost,
            discounting=settings.discounting,
            gae_lambda=settings.gae_lambda,
            clipping_epsilon=settings.clipping_epsilon,
            reward_scaling=settings.reward_scaling,
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
            restore_params=restored,
            restore_value_fn=False,
        )


def _policy(env: Env, parameters: Any) -> MlpPolicy:
    normalizer, policy, *_ = parameters
    network = policy["params"]
    layers = *(network["MLP_0"][f"hidden_{i}"] for i in range(2)), network["Dense_0"]
    return unit_policy(env, normalizer, layers, jnp.exp(network["std_logparam"]["log_value"]))


def _parameters(env: Env, settings: PpoSettings, start: SavedPolicy) -> tuple[Any, Any]:
    """Return the parameters of which :func:`_policy` makes ``start``."""
    require_policy(start)
    start.require_shape(*env_sizes(env)[::-1])
    widths = [len(bias) for _, bias in start.layers[:-1]]
    if widths != [settings.hidden_size] * 2 or not start.is_stochastic:
        raise UserError(
            f"start has hidden layers of {widths} units: ppo goes on from a Gaussian policy of two "
            f"layers of {settings.hidden_size} units, as it trains"
        )
    layers, action_std = unit_layers(env, start)
    normalizer = running_statistics.init_state(jax.ShapeDtypeStruct(start.mean.shape, jnp.float32))
    normalizer = normalizer.replace(
        count=UInt64(hi=0, lo=OBSERVED),
        mean=jnp.asarray(start.mean),
        std=jnp.asarray(start.std),
        summed_variance=OBSERVED * jnp.square(start.std),
    )
    *hidden, last = layers
    network = {
        "MLP_0": {f"hidden_{i}": layer for i, layer in enumerate(hidden)},
        "Dense_0": last,
        "std_logparam": {"log_value": jnp.log(action_std)},
    }
    return normalizer, {"params": network}
