"""A run as it is on disk, finished or not."""

import contextlib
import dataclasses
import math
import reprlib
import shlex
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ailsrs_jax.data.sources import Source, parse_source
from ailsrs_jax.errors import UserError, refusing
from ailsrs_jax.files import read_json_object, require_name
from ailsrs_jax.own_code import is_own
from ailsrs_jax.runs.storage.config import read_config, require_current, require_seed
from ailsrs_jax.runs.storage.journal import RESULT_FILE
from ailsrs_jax.runs.storage.metrics import read_metrics
from ailsrs_jax.trainers.algorithms import changed_settings, find_algorithm

# The fields of config.json, and their types; see RunConfig.
FIELDS: dict[str, tuple[type, ...]] = {
    "env_id": (str,),
    "physics": (str,),
    "seeds": (list,),
    "algorithm": (str,),
    "preset": (str,),
    "settings": (dict,),
    "num_trajectories": (int, type(None)),
    "source": (dict, type(None)),
    "demonstrations_sha256": (str, type(None)),
    "subsample": (int, type(None)),
    "versions": (dict,),
}


@dataclasses.dataclass(frozen=True)
class SavedRun:
    """The content of ``config.json``, ``metrics.csv`` and ``result.json``, checked.

    The files may be a stranger's, so nothing that they name is imported, simulated or downloaded.
    """

    directory: Path
    config: Mapping[str, Any]  # the fields of RunConfig, and versions
    metrics: Mapping[str, np.ndarray]  # by column, with a row for each iteration and seed
    source: Source | None  # of the demonstrations, if there are any
    command: str | None  # makes the run again; None if objects were handed in from Python
    expert_return: float | None  # mean over the demonstrations
    demonstrated_length: int | None  # their time limit in environment steps, if it is recorded
    kept_iterations: Mapping[int, int]  # by seed, without those that have kept no policy yet

    @property
    def title(self) -> str:
        """The algorithm's name for people."""
        name: str = self.config["algorithm"]
        return name if is_own(name) else find_algorithm(name).title

    @property
    def imitates(self) -> bool:
        """Whether the run imitates demonstrations."""
        return self.source is not None

    @property
    def comparable_expert_return(self) -> float | None:
        """The expert's return, if its episodes were as long as those of the run."""
        mine, length = self.config["settings"].get("episode_length"), self.demonstrated_length
        return self.expert_return if length in (None, mine) else None

    def of_seed(self, seed: int) -> dict[str, np.ndarray]:
        """Return the metrics of one seed, with a row for each iteration."""
        mine = self.metrics["seed"] == seed
        return {name: values[mine] for name, values in self.metrics.items()}

    def kept_rows(self) -> Iterator[tuple[int, dict[str, np.ndarray], int]]:
        """Yield each seed that has kept a policy, its metrics, and the row of that policy in them.

        Raises:
            UserError: there is no such row.
        """
        for seed, kept in self.kept_iterations.items():
            metrics = self.of_seed(seed)
            rows = np.flatnonzero(metrics["iteration"] == kept)
            if not len(rows):
                raise UserError(
                    f"{self.directory}: metrics.csv has no iteration {kept} of seed {seed}"
                )
            yield seed, metrics, int(rows[0])

    def without_folder(self) -> "SavedRun":
        """Return the run without the folder of its demonstrations, which is private."""
        source, command = self.source, self.command
        if source is None or source.kind not in ("file", "imitation") or source.name is None:
            return self
        name = Path(source.name).name
        if command is not None:
            words = shlex.split(command)
            command = shlex.join(name if word == source.name else word for word in words)
        source = dataclasses.replace(source, name=name)
        config = {**self.config, "source": dataclasses.asdict(source)}
        return dataclasses.replace(self, config=config, source=source, command=command)

    def changed_settings(self) -> dict[str, Any]:
        """Return the settings that differ from the preset; all, if the preset is unknown."""
        config = self.config
        if not is_own(config["algorithm"]):
            with contextlib.suppress(UserError):  # there is no such preset any more
                return changed_settings(
                    config["env_id"], config["preset"], config["algorithm"], config["settings"]
                )
        return dict(sorted(config["settings"].items()))


def read_run(directory: Path) -> SavedRun:
    """Read a run directory.

    Raises:
        UserError: a file is missing, damaged, or written by an older version.
    """
    path = directory / "config.json"
    config = read_config(path)
    require_current(config, path)
    _require_config(config, path)
    source = parse_source(config["source"], str(path))
    metrics = _read_metrics(directory / "metrics.csv", config)
    path = directory / RESULT_FILE
    result = read_json_object(path, "the result of a run")
    with refusing(f"{path} is not the result of a run"):
        command, expert = result["command"], result["expert_return"]
        kept = {int(seed): each["kept_iteration"] for seed, each in result["seeds"].items()}
        mean = None if expert is None else expert["mean"]
        length = None if expert is None else expert.get("episode_length")
        if not set(kept) <= set(config["seeds"]) or not all(map(_is_count, kept.values())):
            raise ValueError("seeds")
        if not (mean is None or (isinstance(mean, int | float) and math.isfinite(mean))):
            raise ValueError("expert_return")
        if not (length is None or (_is_count(length) and length >= 1)):
            raise ValueError("episode_length")
        # A page shows it for people to copy, so it must not hide a second command.
        if command is not None and (
            not command.startswith("ailsrs train ") or shlex.join(shlex.split(command)) != command
        ):
            raise ValueError("command")
    return SavedRun(directory, config, metrics, source, command, mean, length, kept)


def _require_config(config: Mapping[str, Any], path: Path) -> None:
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
    for name in ("num_trajectories", "subsample"):
        value = config[name]
        is_wrong = value is not None and not (value >= 1 and _is_count(value))
        if is_wrong or (value is None) != (config["source"] is None):
            shown = "missing" if value is None else reprlib.repr(value)
            raise UserError(f"{path} is not the configuration of a run: {name} is {shown}")


def _read_metrics(path: Path, config: Mapping[str, Any]) -> dict[str, np.ndarray]:
    metrics = read_metrics(path)
    columns = ["iteration", "seed", "env_steps", "evaluation_return"]
    if not is_own(config["algorithm"]):
        columns.append(find_algorithm(config["algorithm"]).kept_by)
    if missing := [name for name in columns if name not in metrics]:
        raise UserError(f"{path} has no column {', '.join(missing)}: not the metrics of a run")
    counts = np.stack([metrics[name] for name in ("iteration", "seed")])
    seeds = config["seeds"]
    if not (np.isfinite(counts).all() and counts.size and set(counts[1]) <= set(seeds)):
        raise UserError(f"{path} is not of the run with the seeds {reprlib.repr(seeds)}")
    for seed in seeds:
        iterations = counts[0, counts[1] == seed]
        if not np.array_equal(iterations, np.arange(len(iterations))):
            raise UserError(f"{path} lacks rows of seed {seed}, or has them in another order")
    return metrics


def _is_count(value: Any) -> bool:
    return type(value) is int and 0 <= value < 2**31
