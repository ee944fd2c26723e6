"""Stable-Baselines3 evaluates our policies; it needs PyTorch, which the other tests do not."""

import gymnasium
import numpy as np
import pytest

from ailsrs_jax.data.policies import expert_path, load_policy
from ailsrs_jax.runs.evaluation import evaluate

pytest.importorskip("stable_baselines3")


@pytest.mark.filterwarnings("ignore")
def test_its_evaluation_is_ours() -> None:
    from stable_baselines3.common.env_util import make_vec_env
    from stable_baselines3.common.evaluation import evaluate_policy
    from stable_baselines3.common.utils import set_random_seed

    policy = load_policy(expert_path("Swimmer-v5"))
    envs = make_vec_env("Swimmer-v5", n_envs=4, seed=0)
    mean, std = evaluate_policy(policy, envs, n_eval_episodes=20)
    ours = evaluate(policy, 20)
    assert mean == pytest.approx(ours.mean, abs=3.0)
    assert std == pytest.approx(ours.std, abs=5.0)

    policy, drawn = load_policy(expert_path("Hopper-v5")), []
    for seed in (0, 0, 1):
        set_random_seed(seed)
        envs = make_vec_env("Hopper-v5", n_envs=2, seed=0)
        drawn.append(evaluate_policy(policy, envs, n_eval_episodes=2, deterministic=False)[0])
    assert drawn[0] == drawn[1] != drawn[2]


def test_one_episode_by_hand() -> None:
    policy, env = load_policy(expert_path("Swimmer-v5")), gymnasium.make("Swimmer-v5")
    observation, _ = env.reset(seed=0)
    action, state = policy.predict(observation)
    assert state is None
    assert env.action_space.contains(action.astype(np.float32))
