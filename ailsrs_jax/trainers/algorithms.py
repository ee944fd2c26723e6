"""The algorithms by name: what each learns from, and how it is made."""

import dataclasses
from collections.abc import Callable
from typing import Any

from ailsrs_jax.data.demonstrations import Demonstrations
from ailsrs_jax.envs import Env
from ailsrs_jax.errors import UserError, did_you_mean
from ailsrs_jax.trainers.ailsrs import make_ailsrs
from ailsrs_jax.trainers.ars import make_ars
from ailsrs_jax.trainers.behavior_cloning import make_behavior_cloning
from ailsrs_jax.trainers.gail import make_gail
from ailsrs_jax.trainers.parts.devices import Devices
from ailsrs_jax.trainers.parts.trainer import Trainer
from ailsrs_jax.trainers.trpo import make_trpo


@dataclasses.dataclass(frozen=True)
class Algorithm:
    """One way to train a policy."""

    title: str
    imitates: bool  # learns from demonstrations, not from the environment's reward
    searches: bool  # by directions, which devices can share
    kept_by: str  # column of metrics.csv: the smallest, but for a return, decides what is kept
    make: Callable[..., Trainer]  # env, demonstrations if it imitates, settings, …


ALGORITHMS = {
    "ailsrs": Algorithm(
        "AILSRS", imitates=True, searches=True, kept_by="expert_distance", make=make_ailsrs
    ),
    "bc": Algorithm(
        "BC", imitates=True, searches=False, kept_by="validation_loss", make=make_behavior_cloning
    ),
    "gail": Algorithm(
        "GAIL", imitates=True, searches=False, kept_by="expert_distance", make=make_gail
    ),
    "ars": Algorithm(
        "ARS", imitates=False, searches=True, kept_by="evaluation_return", make=make_ars
    ),
    "brs": Algorithm(
        "BRS", imitates=False, searches=True, kept_by="evaluation_return", make=make_ars
    ),
    "trpo": Algorithm(
        "TRPO", imitates=False, searches=False, kept_by="evaluation_return", make=make_trpo
    ),
}


def find_algorithm(name: str) -> Algorithm:
    """The algorithm called ``name``.

    Raises:
        UserError: there is none.
    """
    if name not in ALGORITHMS:
        hint = did_you_mean(name, ALGORITHMS)
        raise UserError(f"unknown algorithm '{name}'{hint}: use one of {', '.join(ALGORITHMS)}")
    return ALGORITHMS[name]


def make_trainer(
    algorithm: Algorithm,
    env: Env,
    demonstrations: Demonstrations | None,
    settings: Any,
    devices: Devices,
    rollout_batch_size: int | None,
) -> Trainer:
    """The trainer of ``algorithm``.

    Raises:
        UserError: the settings, the demonstrations and the devices do not go together.
    """
    arguments = [env, *([demonstrations] if algorithm.imitates else []), settings]
    if algorithm.searches:
        arguments += [devices, rollout_batch_size]
    return algorithm.make(*arguments)
