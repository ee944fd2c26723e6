"""Several runs as one program: what differs among them becomes an argument with a leading axis."""

import dataclasses
from collections.abc import Callable, Hashable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ailsrs_jax.own_code import is_own
from ailsrs_jax.runs.plan import Plan
from ailsrs_jax.trainers.parts.reference import Reference
from ailsrs_jax.trainers.parts.trainer import Trainer


def stack_key(plan: Plan) -> Hashable:
    """Return a key that is equal for runs that can be stacked.

    It has all settings except for the real-valued ones. Of those it only says whether they are 0,
    because a term with weight 0 is left out of the program. Demonstrations may differ in the number
    of episodes but not in their length. Runs of your own algorithm may differ in nothing but the
    seed, because nobody knows what else its trainer has made of settings and demonstrations.
    """
    config, demonstrations = plan.config, plan.data.demonstrations
    if is_own(config.algorithm):
        everything = config.settings, config.demonstrations_sha256
        return config.algorithm, config.env_id, config.physics, *everything
    settings = tuple(
        (name, value == 0 if isinstance(value, float) else value)
        for name, value in vars(config.settings).items()
    )
    recorded = None
    if demonstrations is not None:
        has_actions = demonstrations.actions is not None
        recorded = (demonstrations.observations.shape[1:], demonstrations.stride, has_actions)
    return config.algorithm, config.env_id, config.physics, settings, recorded


def stack_trainers(trainers: Sequence[Trainer]) -> tuple[Callable[[Any], Trainer], Any]:
    """Return a function that makes a trainer from its slice of arrays, and these arrays.

    The arrays hold the settings and demonstrations that differ, with one row for each trainer. All
    else is a constant of the program. Of one trainer there are no arrays.
    """
    if len(trainers) == 1:
        return lambda _: trainers[0], {}
    members: list[Any] = list(trainers)  # only some have a reference
    template = members[0]
    settings = [vars(trainer.settings) for trainer in members]
    arguments: dict[str, Any] = {
        "settings": {
            name: np.array([each[name] for each in settings], np.float32)
            for name in settings[0]
            if len({each[name] for each in settings}) > 1
        }
    }
    if hasattr(template, "reference"):
        references = [trainer.reference for trainer in members]
        if not all(map(_same, references, references[1:])):
            most = max(len(reference.lengths) for reference in references)
            padded = [_pad(reference, most) for reference in references]
            arguments["reference"] = jax.tree.map(lambda *xs: jnp.stack(xs), *padded)

    if not (arguments["settings"] or "reference" in arguments):
        return lambda _: template, {}

    def make(part: Any) -> Trainer:
        changes = {"settings": dataclasses.replace(template.settings, **part["settings"])}
        if "reference" in part:
            changes["reference"] = part["reference"]
        made: Trainer = dataclasses.replace(template, **changes)
        return made

    return make, arguments


def _same(one: Reference, other: Reference) -> bool:
    return jax.tree.all(jax.tree.map(np.array_equal, one, other))


def _pad(reference: Reference, num_episodes: int) -> Reference:
    """Append episodes without steps, which are never sampled."""

    def pad(array: jax.Array) -> jax.Array:
        missing = num_episodes - len(reference.lengths)
        return jnp.pad(array, [(0, missing)] + [(0, 0)] * (array.ndim - 1))

    names = "observations", "actions", "lengths"
    padded: Reference = reference.replace(**{name: pad(getattr(reference, name)) for name in names})
    return padded
