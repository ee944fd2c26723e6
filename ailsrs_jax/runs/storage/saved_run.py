"""A run as it is on disk, finished or not: what it was asked to do, and what it has measured."""

import contextlib
import dataclasses
import re
import reprlib
import shlex
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ailsrs_jax.data.sources import MINARI
from ailsrs_jax.envs.registry import (
    TASKS,
    require_harmless,
    resolve_env_id,
    short_name,
    takes_physics,
)
from ailsrs_jax.errors import UserError
from ailsrs_jax.files import require_name
from ailsrs_jax.runs.run import make_plan
from ailsrs_jax.runs.storage.config import read_config, require_seed
from ailsrs_jax.runs.storage.metrics import read_metrics
from ailsrs_jax.runs.training_data import HANDED_IN, NUM_TRAJECTORIES, SHIPPED_EXPERT
from ailsrs_jax.trainers.algorithms import changed_settings, find_algorithm
from ailsrs_jax.trainers.parts.settings import as_text
from ailsrs_jax.trainers.parts.trainer import Algorithm

# What config.json holds, and of what type; see RunConfig.
FIELDS: dict[str, tuple[type, ...]] = {
    "env_id": (str,),
    "physics": (str,),
    "seeds": (list,),
    "algorithm": (str,),
    "preset": (str,),
    "settings": (dict,),
    "num_trajectories": (int, type(None)),
    "demonstrations": (str, type(None)),
    "demonstrations_sha256": (str, type(None)),
    "subsample": (int, type(None)),
    "versions": (dict,),
}


@dataclasses.dataclass(frozen=True)
class SavedRun:
    """What ``config.json`` and ``metrics.csv`` say, checked; the rest of the directory is not."""

    directory: Path
    config: Mapping[str, Any]  # the fields of RunConfig, and versions
    metrics: Mapping[str, np.ndarray]  # by column, a row for each iteration and seed

    @property
    def algorithm(self) -> Algorithm:
        """What has trained it."""
        return find_algorithm(self.config["algorithm"])

    @property
    def kept_iterations(self) -> dict[int, int]:
        """When the kept policy of each seed was found, where one was: as the trainers choose."""
        scores = self.metrics[self.algorithm.kept_by]
        if self.algorithm.kept_by != "evaluation_return":
            scores = -scores
        kept = {}
        for seed in self.config["seeds"]:
            mine = self.metrics["seed"] == seed
            if np.isfinite(scores[mine]).any():
                best = np.nanargmax(np.where(np.isfinite(scores[mine]), scores[mine], np.nan))
                kept[seed] = int(self.metrics["iteration"][mine][best])
        return kept

    def changed_settings(self) -> dict[str, str]:
        """What differs from the preset; all of them, if there is no such preset any more."""
        config = self.config
        try:
            changed = changed_settings(
                config["env_id"], config["preset"], config["algorithm"], config["settings"]
            )
            return {name: as_text(value) for name, value in changed.items()}
        except UserError:
            return {name: as_text(value) for name, value in sorted(config["settings"].items())}

    def command(self) -> str | None:
        """The ``ailsrs train`` that makes it again, where one does: Python can hand in objects."""
        config, source = self.config, self._source
        try:
            env_id = resolve_env_id(config["env_id"])
        except UserError:
            return None
        if source == HANDED_IN:
            return None
        words = ["ailsrs", "train", short_name(env_id) if env_id in TASKS else env_id]
        if config["algorithm"] != "ailsrs":
            words += ["--algorithm", config["algorithm"]]
        number = config["num_trajectories"]
        if source not in (None, SHIPPED_EXPERT):
            words += ["--demonstrations", source]
        if number is not None and (source, number) != (SHIPPED_EXPERT, NUM_TRAJECTORIES):
            words += ["--num-trajectories", str(number)]
        if config["subsample"] not in (None, 1):
            words += ["--subsample", str(config["subsample"])]
        words += ["--seeds", *map(str, config["seeds"])]
        if config["preset"] != "tuned":
            words += ["--preset", config["preset"]]
        if (physics := self._asked_physics()) != "auto":
            words += ["--physics", physics]
        changed = self.changed_settings()
        if changed:
            words += ["--set", *(f"{name}={value}" for name, value in changed.items())]
        return shlex.join(words)

    def expert_return(self) -> float | None:
        """Mean return of the demonstrations, if they are still there and the same.

        Minari would download what is not, so there it is not looked.

        Raises:
            UserError: its own task is one that is not to be looked up.
        """
        config, source = self.config, self._source
        if source is None or source == HANDED_IN or source.startswith(MINARI):
            return None
        require_harmless(config["env_id"], str(self.directory))
        with contextlib.suppress(UserError):
            plan = make_plan(
                config["env_id"],
                None if source == SHIPPED_EXPERT else source,
                config["num_trajectories"],
                config["seeds"],
                "paper",
                self._asked_physics(),
                {},
                subsample=config["subsample"],
                algorithm="bc",
            )
            same = plan.config.demonstrations_sha256 == config["demonstrations_sha256"]
            if same and plan.demonstrations is not None:
                return float(np.mean(plan.demonstrations.returns))
        return None

    def _asked_physics(self) -> str:
        """The engine, where it is for ``--physics`` to say: some tasks have one of their own."""
        env_id: str = self.config["env_id"]
        with contextlib.suppress(UserError):
            require_harmless(env_id, str(self.directory))
            if takes_physics(env_id):
                return str(self.config["physics"])
        return "auto"

    @property
    def _source(self) -> str | None:
        """Where the demonstrations are from, without the note on what was left out of them."""
        source: str | None = self.config["demonstrations"]
        return source and re.sub(r" \(\d+ cut off, left out\)$", "", source)


def read_run(directory: Path) -> SavedRun:
    """Read ``config.json`` and ``metrics.csv``.

    Raises:
        UserError: one is missing, damaged, or not of a run that we know.
    """
    path = directory / "config.json"
    config = read_config(path)
    for name, kinds in FIELDS.items():
        if name not in config or type(config[name]) not in kinds:
            value = reprlib.repr(config[name]) if name in config else "missing"
            raise UserError(f"{path} is not the configuration of a run: {name} is {value}")
    require_name(config["env_id"], str(path))
    seeds = config["seeds"]
    if not seeds or not all(type(seed) is int for seed in seeds):
        raise UserError(f"{path}: seeds are {reprlib.repr(seeds)}, not whole numbers")
    for seed in seeds:
        require_seed(seed)
    for name, value in (config["settings"] | config["versions"]).items():
        if not isinstance(value, bool | int | float | str):
            raise UserError(f"{path}: {reprlib.repr(name)} is {reprlib.repr(value)}, not a value")
    if config["demonstrations"] is not None:
        for name in ("num_trajectories", "subsample"):
            if config[name] is None:
                raise UserError(f"{path} is not the configuration of a run: {name} is missing")
    algorithm = find_algorithm(config["algorithm"])
    path = directory / "metrics.csv"
    metrics = read_metrics(path)
    columns = ("iteration", "seed", "env_steps", "evaluation_return", algorithm.kept_by)
    if missing := [name for name in columns if name not in metrics]:
        raise UserError(f"{path} has no column {', '.join(missing)}: not the metrics of a run")
    counts = np.stack([metrics[name] for name in ("iteration", "seed")])
    if not (np.isfinite(counts).all() and counts.size and set(counts[1]) <= set(seeds)):
        raise UserError(f"{path} is not of the run with the seeds {reprlib.repr(seeds)}")
    return SavedRun(directory, config, metrics)
