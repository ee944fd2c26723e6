"""Policies on their way between JAX and files."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np

from ailsrs_jax.components.policy import LinearPolicy, MlpPolicy, Policy
from ailsrs_jax.data.policies import SavedLinearPolicy, SavedMlpPolicy, SavedPolicy


def saved_policy(policy: Policy, env_id: str) -> SavedPolicy:
    """The policy as it goes to disk."""
    kind = SavedLinearPolicy if isinstance(policy, LinearPolicy) else SavedMlpPolicy
    return kind(**vars(jax.tree.map(np.asarray, policy)), env_id=env_id)


def jax_policy(saved: SavedPolicy) -> Policy:
    """The policy as it is simulated, in float32."""
    fields = {field.name: getattr(saved, field.name) for field in dataclasses.fields(saved)}
    del fields["env_id"]
    policy = (LinearPolicy if isinstance(saved, SavedLinearPolicy) else MlpPolicy)(**fields)
    in_float32: Policy = jax.tree.map(jnp.float32, policy)
    return in_float32
