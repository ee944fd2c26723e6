"""Saved policies as JAX functions, a policy that does nothing, and the shipped experts."""

import dataclasses

import jax
import jax.numpy as jnp

from ailsrs_jax.components.policy import LinearPolicy, MlpPolicy, Policy
from ailsrs_jax.data.policies import SavedLinearPolicy, SavedPolicy, expert_path, load_policy
from ailsrs_jax.envs import Env
from ailsrs_jax.envs.interface import action_range, env_sizes
from ailsrs_jax.envs.registry import resolve_env_id


def jax_policy(saved: SavedPolicy) -> Policy:
    """Return the policy as a JAX function ``(n,)`` → ``(p,)`` in float32, as it is simulated.

    >>> import ailsrs_jax as ail
    >>> import jax
    >>> policy = ail.jax_policy(ail.load_expert("hopper"))
    >>> jax.jit(jax.vmap(policy))(jax.numpy.zeros((5, 11))).shape
    (5, 3)
    """
    fields = {field.name: getattr(saved, field.name) for field in dataclasses.fields(saved)}
    del fields["env_id"], fields["episode_length"]
    policy = (LinearPolicy if isinstance(saved, SavedLinearPolicy) else MlpPolicy)(**fields)
    in_float32: Policy = jax.tree.map(jnp.float32, policy)
    return in_float32


def still_policy(env: Env) -> LinearPolicy:
    """Return the policy of ``env`` whose actions are 0."""
    n, p = env_sizes(env)
    return LinearPolicy(jnp.zeros((p, n)), jnp.zeros(n), jnp.ones(n), *action_range(env))


def load_expert(env: str, name: str | None = None) -> SavedPolicy:
    """Load an expert that ships with the package.

    >>> import ailsrs_jax as ail
    >>> ail.load_expert("hopper").env_id
    'Hopper-v5'

    Args:
        env: the task, ``Hopper-v5`` or ``hopper``.
        name: ``paper`` for the one that returns what the paper's does, ``linear`` for a linear one.

    Raises:
        UserError: the task is unknown, or no such expert ships for it.
    """
    return load_policy(expert_path(resolve_env_id(env), name))
