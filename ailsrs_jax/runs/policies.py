"""Policies on their way between JAX and files."""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ailsrs_jax.components.policy import LinearPolicy, MlpPolicy, Policy
from ailsrs_jax.data.policies import (
    SavedLinearPolicy,
    SavedMlpPolicy,
    SavedPolicy,
    expert_path,
    load_policy,
)
from ailsrs_jax.envs.registry import resolve_env_id
from ailsrs_jax.runs.storage.config import RunConfig


def saved_policy(policy: Policy, env_id: str) -> SavedPolicy:
    """The policy as it goes to disk."""
    kind = SavedLinearPolicy if isinstance(policy, LinearPolicy) else SavedMlpPolicy
    return kind(**vars(jax.tree.map(np.asarray, policy)), env_id=env_id)


def kept_policies(state: Any, config: RunConfig) -> dict[int, SavedPolicy]:
    """The kept policy of each seed of a run, from the training state of all of them."""
    policies = jax.tree.map(np.asarray, state.kept.policy)
    return {
        seed: saved_policy(jax.tree.map(lambda x, i=index: x[i], policies), config.env_id)
        for index, seed in enumerate(config.seeds)
    }


def jax_policy(saved: SavedPolicy) -> Policy:
    """The policy as a JAX function, ``(n,)`` to ``(p,)``, in float32: it is what is simulated.

    >>> import ailsrs_jax as ail
    >>> import jax
    >>> policy = ail.jax_policy(ail.load_expert("hopper"))
    >>> jax.jit(jax.vmap(policy))(jax.numpy.zeros((5, 11))).shape
    (5, 3)
    """
    fields = {field.name: getattr(saved, field.name) for field in dataclasses.fields(saved)}
    del fields["env_id"]
    policy = (LinearPolicy if isinstance(saved, SavedLinearPolicy) else MlpPolicy)(**fields)
    in_float32: Policy = jax.tree.map(jnp.float32, policy)
    return in_float32


def load_expert(env: str, *, of_paper: bool = False) -> SavedPolicy:
    """The expert that ships with the package.

    >>> import ailsrs_jax as ail
    >>> ail.load_expert("hopper").env_id
    'Hopper-v5'

    Args:
        env: the task, ``Hopper-v5`` or ``hopper``.
        of_paper: the one whose return is that of the paper's, where it is another one.

    Raises:
        UserError: there is no such task, or none ships for it.
    """
    return load_policy(expert_path(resolve_env_id(env), of_paper=of_paper))
