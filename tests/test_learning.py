"""Whole runs: the shipped experts are experts, and the tuned preset imitates them."""

import numpy as np
import pytest

from ailsrs_jax.data.policies import expert_path, load_policy
from ailsrs_jax.runs.evaluation import evaluate
from ailsrs_jax.runs.run import train

EXPERT_RETURNS = {
    "HalfCheetah-v5": 4000,
    "Hopper-v5": 3000,
    "Swimmer-v5": 340,
    "Walker2d-v5": 1000,
}


@pytest.mark.slow
@pytest.mark.parametrize(("env_id", "least"), EXPERT_RETURNS.items())
def test_experts_are_good_enough_to_be_called_so(env_id: str, least: float) -> None:
    assert evaluate(load_policy(expert_path(env_id)), 100, "gymnasium").mean >= least


@pytest.mark.slow
@pytest.mark.timeout(1800)
@pytest.mark.parametrize(("env", "share"), [("hopper", 0.85), ("swimmer", 0.95)])
def test_two_of_three_seeds_come_near_the_expert(env: str, share: float) -> None:
    result = train(env, num_trajectories=10, seeds=(0, 1, 2))
    kept = [evaluate(policy, 100, "gymnasium").mean for policy in result.policies.values()]
    expert = evaluate(load_policy(expert_path(result.config.env_id)), 100, "gymnasium").mean
    assert np.sum(np.array(kept) >= share * expert) >= 2, (kept, expert)
