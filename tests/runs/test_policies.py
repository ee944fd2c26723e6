import jax
import jax.numpy as jnp
import numpy as np

from ailsrs_jax.components.policy import MlpPolicy
from ailsrs_jax.data.policies import load_policy
from ailsrs_jax.runs.policies import jax_policy
from ailsrs_jax.runs.storage.policies import saved_policy


def test_numpy_and_jax_agree(tmp_path) -> None:
    keys = jax.random.split(jax.random.key(0), 7)
    policy = MlpPolicy(
        weights=(jax.random.normal(keys[0], (16, 5)), jax.random.normal(keys[1], (3, 16))),
        biases=(jax.random.normal(keys[2], (16,)), jax.random.normal(keys[3], (3,))),
        mean=jax.random.normal(keys[4], (5,)),
        std=jnp.exp(jax.random.normal(keys[5], (5,))),
        action_low=jnp.array([-1.0, -0.4, 0.0]),
        action_high=jnp.array([1.0, 0.4, 5.0]),
        action_std=jnp.array([0.1, 0.2, 0.3]),
    )
    saved_policy(policy, "Nowhere-v0").save(tmp_path / "policy.npz")
    saved = load_policy(tmp_path / "policy.npz")
    observations = np.asarray(jax.random.normal(keys[6], (100, 5)))
    in_numpy = np.stack([saved(x) for x in observations])
    for version in (policy, jax_policy(saved)):
        np.testing.assert_allclose(jax.vmap(version)(observations), in_numpy, atol=1e-5)
