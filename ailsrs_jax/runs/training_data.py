"""The demonstrations of a run: read, checked against the task, and hashed."""

import dataclasses
from collections.abc import Callable
from typing import NamedTuple

import jax
import numpy as np

from ailsrs_jax.data.demonstrations import Demonstrations
from ailsrs_jax.data.sources import EXPERT, Source, content_hash, open_source
from ailsrs_jax.envs import Env
from ailsrs_jax.envs.interface import action_range, starts_at_observations
from ailsrs_jax.errors import UserError
from ailsrs_jax.runs.demonstrate import expert_demonstrations
from ailsrs_jax.runs.inverse_dynamics import infer_actions
from ailsrs_jax.runs.spec import RunSpec
from ailsrs_jax.trainers.parts.reference import require_sizes

NUM_TRAJECTORIES = 10  # of the shipped expert by default, the paper's smallest number


class TrainingData(NamedTuple):
    """The demonstrations that a run is trained on; all None if it learns from the reward."""

    demonstrations: Demonstrations | None = None
    #: simulates them, and returns them with actions; None if they have any, or it cannot be done
    infer: Callable[[], Demonstrations] | None = None
    source: Source | None = None
    sha256: str | None = None  # of the arrays
    source_sha256: str | None = None  # the same before they are drawn and subsampled
    num_trajectories: int | None = None
    subsample: int | None = None
    time_limit: int | None = None  # of all demonstrations of the source, in environment steps
    expert_returns: np.ndarray | None = None  # of all episodes that could have been drawn


def read_training_data(spec: RunSpec, env: Env, env_id: str, engine: str) -> TrainingData:
    """Read the demonstrations that ``spec`` names, or roll out the shipped expert on ``engine``.

    Raises:
        UserError: they cannot be read, do not fit the task, or are too few.
    """
    asked, number = spec.demonstrations, spec.num_trajectories
    if spec.draw_from is not None:
        number = _checked_draw(spec)
    if asked is None or (isinstance(asked, str) and asked.startswith(EXPERT)):
        source = Source("expert", asked and asked.removeprefix(EXPERT))
        number = NUM_TRAJECTORIES if number is None else number
        demonstrations = expert_demonstrations(env_id, number, engine, source.name)
    else:
        demonstrations, source = open_source(asked, env_id, number)
    if number is not None:
        demonstrations = demonstrations.first(number)
    expert_returns = np.asarray(demonstrations.returns)
    source_sha256 = content_hash(demonstrations)
    if spec.draw_from is not None:
        order = np.random.default_rng(spec.seeds[0]).permutation(spec.draw_from)
        drawn = order[: spec.num_trajectories]
        demonstrations = jax.tree.map(lambda x: np.asarray(x)[drawn], demonstrations)
    require_fit(demonstrations, env_id, env)
    if spec.states_only:
        demonstrations = demonstrations.replace(actions=None)
        source = dataclasses.replace(source, states_only=True)

    def thinned(demonstrations: Demonstrations) -> Demonstrations:
        if spec.subsample == 1:
            return demonstrations
        offsets_seed = 0 if spec.draw_from is None else spec.seeds[0]
        return demonstrations.subsample(spec.subsample, offsets_seed)

    def infer() -> Demonstrations:
        return thinned(infer_actions(demonstrations, env))

    unknown = demonstrations.actions is None and demonstrations.stride == 1
    given = thinned(demonstrations)
    return TrainingData(
        given,
        infer if unknown and starts_at_observations(env) else None,
        source,
        content_hash(given),
        source_sha256,
        given.num_trajectories,
        spec.subsample,
        demonstrations.time_limit,
        expert_returns,
    )


def _checked_draw(spec: RunSpec) -> int:
    """Return how many episodes ``spec`` draws from."""
    asked, drawn_from = spec.num_trajectories, spec.draw_from
    assert drawn_from is not None
    if asked is None or not 1 <= asked <= drawn_from:
        raise UserError(
            f"draw_from is {drawn_from}, num_trajectories is {asked}: give the number of "
            "trajectories, from 1 to the number that they are drawn from"
        )
    if len(spec.seeds) != 1:
        raise UserError(
            f"draw_from is for a single seed, which draws its own trajectories, not for "
            f"{len(spec.seeds)} that share them: start a run for each, or a sweep"
        )
    return drawn_from


def require_fit(demonstrations: Demonstrations, env_id: str, env: Env) -> None:
    """Raise UserError unless the demonstrations have the sizes and the action range of ``env``."""
    if demonstrations.env_id != env_id:
        raise UserError(f"the demonstrations are of {demonstrations.env_id}, not of {env_id}")
    require_sizes(demonstrations, env)
    actions = demonstrations.actions
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
