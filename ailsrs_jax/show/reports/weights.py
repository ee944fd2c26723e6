"""The weights of a linear policy, beside those of a clone of the expert."""

import contextlib
import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np

from ailsrs_jax.components.linear_regression import affine_regression
from ailsrs_jax.data.policies import SavedLinearPolicy, SavedPolicy
from ailsrs_jax.envs.registry import open_env, require_harmless
from ailsrs_jax.envs.tasks.entry_names import action_names, observation_names
from ailsrs_jax.envs.tasks.mujoco_task import MujocoTask
from ailsrs_jax.errors import UserError
from ailsrs_jax.trainers.parts.reference import Reference

MOST_ENTRIES = 32  # of an observation that are shown


@dataclasses.dataclass(frozen=True)
class WeightMaps:
    """Tables of weights whose cells are coloured."""

    title: str
    maps: Mapping[str, Sequence[tuple[str, list[float]]]]  # by title: an entry and its weights
    actions: Sequence[str]
    largest: float  # has the full colour
    caption: str


def weight_maps(name: str, policy: SavedPolicy, expert: Reference | None) -> WeightMaps | None:
    """Show the weights of ``policy`` and, if ``expert`` is known, of its clone.

    Returns None for a policy that is not linear.
    """
    if not isinstance(policy, SavedLinearPolicy):
        return None
    scale = policy.std if expert is None else np.asarray(expert.statistics.std)
    weights = {name: policy.weights * (scale / policy.std)}
    if expert is not None:
        clone = affine_regression(expert.observations, expert.actions, expert.alive)
        weights["clone of the expert"] = np.asarray(clone)[:, :-1]
    entries, names = _names(policy)
    largest = np.max([np.abs(each).max(axis=0) for each in weights.values()], axis=0)
    shown = np.sort(np.argsort(-largest)[:MOST_ENTRIES])
    left_out = len(entries) - len(shown)
    return WeightMaps(
        "Policy",
        {
            title: [(entries[at], each[:, at].tolist()) for at in shown]
            for title, each in weights.items()
        },
        names,
        float(largest.max()) or 1.0,
        "A number is what one standard deviation of an entry of the observation adds to an action."
        + (" The clone is a linear regression on the demonstrations." if expert is not None else "")
        + (f" The {left_out} entries with the smallest weights are left out." if left_out else ""),
    )


def _names(policy: SavedLinearPolicy) -> tuple[list[str], list[str]]:
    """Return the names of the observation's entries and of the actions, else their numbers."""
    p, n = policy.weights.shape
    entries, actions = [f"entry {at}" for at in range(n)], [f"action {at}" for at in range(p)]
    with contextlib.suppress(UserError):  # a task that is gone has no names
        require_harmless(policy.env_id, "the policy")
        task = getattr(open_env(policy.env_id).env, "unwrapped", None)
        if isinstance(task, MujocoTask):
            if len(names := observation_names(task)) == n:
                entries = names
            if len(names := action_names(task)) == p:
                actions = names
    return entries, actions
