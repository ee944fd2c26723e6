"""The specification of a run."""

import dataclasses
import shlex
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import gymnasium

from ailsrs_jax.data.demonstrations import Demonstrations
from ailsrs_jax.envs import Env
from ailsrs_jax.trainers.parts.settings import as_text


@dataclasses.dataclass(frozen=True)
class RunSpec:
    """A run as a person asks for it, on the command line, in Python or in a sweep.

    Attributes:
        env: the task, ``Hopper-v5`` or ``hopper``; any environment of Gymnasium as
            ``gymnasium:ID``; your own as ``module:attribute``; any Brax environment; or a function
            that makes one of Gymnasium.
        demonstrations: a ``.npz`` file, ``minari:DATASET_ID``, a directory that the imitation
            library wrote, or demonstrations in memory. None stands for the expert that ships with
            the package, ``expert:paper`` for the one with the paper's return, and ``expert:linear``
            for a linear one.
        algorithm: ``ailsrs``, ``bc`` or ``gail``, which imitate demonstrations; or ``ars``, ``brs``
            or ``trpo``, which learn from the environment's reward.
        num_trajectories: use the first n episodes; by default 10 of the shipped expert, else all.
        draw_from: draw the n episodes at random from this many first ones, with the only seed of
            the run; by default the first n are used.
        subsample: train only on every k-th step of an episode.
        states_only: do not use the actions of the demonstrations.
        seeds: random seeds, trained together as one batched program.
        preset: ``tuned`` or ``paper``.
        settings: settings of the algorithm that replace those of the preset, such as
            ``{"noise_std": 0.02}``.
        physics: ``auto``, ``mjx`` or ``mujoco``, for a task given by name.
        rollout_batch_size: how many simulations a device runs at a time in random search; fewer
            need less memory and change the results by rounding only. By default the fastest.
        workers: how many processes run the episodes of an environment of Gymnasium, by default one
            for each core; or ``ray:N`` for N actors on a Ray cluster. The results do not depend on
            it.
        worker_timeout: seconds that an episode may take there before its worker is replaced.
    """

    env: Env | str | Callable[[], gymnasium.Env]
    demonstrations: str | Path | Demonstrations | None = None
    algorithm: str = "ailsrs"
    num_trajectories: int | None = None
    draw_from: int | None = None
    subsample: int = 1
    states_only: bool = False
    seeds: Sequence[int] = (0,)
    preset: str = "tuned"
    settings: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    physics: str = "auto"
    rollout_batch_size: int | None = None
    workers: int | str | None = None
    worker_timeout: float | None = None

    @property
    def command(self) -> str | None:
        """The ``ailsrs train`` that makes this run; None if it has objects that have no name."""
        if not isinstance(self.env, str) or isinstance(self.demonstrations, Demonstrations):
            return None
        words = ["ailsrs", "train", self.env]
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if field.name == "seeds":
                words += ["--seeds", *map(str, value)]
            elif field.name not in ("env", "settings") and value != field.default:
                words.append(f"--{field.name.replace('_', '-')}")
                words += [] if value is True else [str(value)]
        if self.settings:
            settings = sorted(self.settings.items())
            words += ["--set", *(f"{name}={as_text(value)}" for name, value in settings)]
        return shlex.join(words)
