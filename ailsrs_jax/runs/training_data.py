"""What a run imitates: demonstrations from wherever they are, checked against the task."""

import os
from pathlib import Path

import numpy as np

from ailsrs_jax.data.demonstrations import Demonstrations, validated
from ailsrs_jax.data.sources import open_source
from ailsrs_jax.envs import Env
from ailsrs_jax.envs.interface import action_range, env_sizes
from ailsrs_jax.errors import UserError
from ailsrs_jax.runs.demonstrate import expert_demonstrations

NUM_TRAJECTORIES = 10  # of the shipped expert: the paper's fewest
PAPER_EXPERT = "expert:paper"

# What config.json says of demonstrations that have no name.
SHIPPED_EXPERT = "of the expert that ships with the package"
HANDED_IN = "handed in"


def find_demonstrations(
    demonstrations: str | Path | Demonstrations | None,
    num_trajectories: int | None,
    env_id: str,
    engine: str,
) -> tuple[Demonstrations, str]:
    """The first ``num_trajectories`` of what is asked for, and what to call it.

    Raises:
        UserError: they cannot be read, or there are fewer.
    """
    if demonstrations is None or demonstrations == PAPER_EXPERT:
        source = demonstrations or SHIPPED_EXPERT
        of_paper = demonstrations == PAPER_EXPERT
        num_trajectories = NUM_TRAJECTORIES if num_trajectories is None else num_trajectories
        demonstrations = expert_demonstrations(env_id, num_trajectories, engine, of_paper=of_paper)
    elif isinstance(demonstrations, Demonstrations):
        source = HANDED_IN
        demonstrations = validated(vars(demonstrations), "the demonstrations handed in")
    else:
        demonstrations, source = open_source(demonstrations, env_id, num_trajectories)
    if num_trajectories is not None:
        demonstrations = demonstrations.first(num_trajectories)
    # A name on the disk can be any bytes, which no other file could hold.
    return demonstrations, os.fsencode(source).decode(errors="backslashreplace")


def require_fit(demonstrations: Demonstrations, env_id: str, env: Env) -> None:
    """Raise UserError unless the demonstrations are of ``env``, in their sizes and actions."""
    if demonstrations.env_id != env_id:
        raise UserError(f"the demonstrations are of {demonstrations.env_id}, not of {env_id}")
    n, p = env_sizes(env)
    actions = demonstrations.actions
    observed = demonstrations.observations.shape[-1]
    acted = p if actions is None else actions.shape[-1]
    if (observed, acted) != (n, p):
        raise UserError(
            f"the demonstrations have {observed} observations and "
            f"{'no' if actions is None else acted} actions: {env_id} has {n} and {p}"
        )
    if actions is None:
        return
    low, high = map(np.asarray, action_range(env))
    alive = np.asarray(demonstrations.alive)
    slack = 1e-5 * (high - low)  # for rounding
    for index, values in enumerate(np.asarray(actions)[alive].T):
        if values.min() < low[index] - slack[index] or values.max() > high[index] + slack[index]:
            raise UserError(
                f"action {index} of the demonstrations goes from {values.min():g} to "
                f"{values.max():g}: {env_id} takes {low[index]:g} to {high[index]:g}"
            )
