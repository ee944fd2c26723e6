"""Policies with an intercept, as they are saved."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ailsrs_jax.components.policy import LinearPolicy
from ailsrs_jax.data.policies import SavedLinearPolicy, SavedMlpPolicy
from ailsrs_jax.runs.policies import jax_policy
from ailsrs_jax.runs.storage.policies import saved_policy


@pytest.mark.parametrize("rows", ["independent", "singular", "tiny"])
def test_a_saved_policy_with_an_intercept_acts_the_same(rows: str) -> None:
    """In float32, too: to shift the mean for a tiny row, it would have to be 1e7 away."""
    rng = np.random.default_rng(0)
    weights = rng.normal(size=(3, 5)).astype(np.float32)
    if rows == "singular":
        weights[2] = weights[1]
    elif rows == "tiny":
        weights[2] *= 1e-7
    intercept, mean = rng.normal(size=3), rng.normal(size=5)
    policy = LinearPolicy(
        *map(jnp.float32, (weights, mean, rng.uniform(0.5, 2.0, 5), -2 * np.ones(3), np.ones(3))),
        intercept=jnp.float32(intercept),
    )
    saved = saved_policy(policy, "Swimmer-v5")
    assert type(saved) is (SavedLinearPolicy if rows == "independent" else SavedMlpPolicy)
    assert not saved.is_stochastic
    observations = rng.normal(size=(20, 5)).astype(np.float32)
    for same in (saved, jax.vmap(jax_policy(saved))):
        np.testing.assert_allclose(
            same(observations), jax.vmap(policy)(observations), rtol=1e-4, atol=1e-5
        )


def test_a_saved_policy_without_an_intercept_is_the_policy() -> None:
    policy = LinearPolicy(*map(jnp.ones, ((3, 5), 5, 5, 3, 3)), intercept=jnp.zeros(3))
    saved = saved_policy(policy, "Swimmer-v5")
    np.testing.assert_array_equal(saved.mean, policy.mean)
