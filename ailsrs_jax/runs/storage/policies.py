"""Policies of a training state, as they are saved."""

from typing import Any

import jax
import numpy as np

from ailsrs_jax.components.policy import LinearPolicy, Policy
from ailsrs_jax.data.policies import SavedLinearPolicy, SavedMlpPolicy, SavedPolicy
from ailsrs_jax.runs.storage.config import RunConfig


def saved_policy(policy: Policy, env_id: str) -> SavedPolicy:
    """Return ``policy`` as NumPy arrays that can be saved."""
    kind = SavedLinearPolicy if isinstance(policy, LinearPolicy) else SavedMlpPolicy
    return kind(**vars(jax.tree.map(np.asarray, policy)), env_id=env_id)


def kept_policies(state: Any, config: RunConfig) -> dict[int, SavedPolicy]:
    """Return the kept policy of each seed, from the training state of all seeds."""
    policies = jax.tree.map(np.asarray, state.kept.policy)
    return {
        seed: saved_policy(jax.tree.map(lambda x, i=index: x[i], policies), config.env_id)
        for index, seed in enumerate(config.seeds)
    }
