"""The tasks are Brax environments: Brax's wrappers and trainers accept them."""

import jax
import jax.numpy as jnp
import numpy as np
from brax.envs.wrappers import training
from brax.training.acting import Evaluator

from ailsrs_jax.envs import Env
from ailsrs_jax.envs.registry import make_env


def test_brax_wrappers_reset_episodes_that_end() -> None:
    env = make_env("hopper", "mujoco")
    assert isinstance(env, Env)
    wrapped = training.wrap(env, episode_length=15)
    # Brax needs the old kind of key to find the batch size.
    state = jax.jit(wrapped.reset)(jax.random.split(jax.random.PRNGKey(0), 3))
    first = state.obs
    step, ended = jax.jit(wrapped.step), jnp.zeros(3, bool)
    for _ in range(15):
        state = step(state, 0.1 * jnp.ones((3, 3)))
        ended |= state.done == 1
    assert bool(ended.all())  # at the time limit, if not before
    assert bool(jnp.isfinite(state.obs).all())
    assert bool((jnp.abs(state.obs - first) < 1e-6).all(axis=1).any())


def test_brax_evaluates_on_the_tasks() -> None:
    """Brax's evaluator adds the reward to the state's metrics, which a step must keep."""
    env = make_env("swimmer", "mujoco")
    evaluator = Evaluator(
        training.wrap(env, episode_length=10),
        lambda _: lambda observations, _: (jnp.ones((*observations.shape[:-1], 2)), {}),
        num_eval_envs=2,
        episode_length=10,
        action_repeat=1,
        key=jax.random.PRNGKey(0),
    )
    metrics = evaluator.run_evaluation((), training_metrics={})
    assert metrics["eval/avg_episode_length"] == 10
    terms = metrics["eval/episode_reward_forward"] + metrics["eval/episode_reward_ctrl"]
    np.testing.assert_allclose(metrics["eval/episode_reward"], terms, rtol=1e-5)
