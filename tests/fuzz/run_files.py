"""Damaged files of a run: configuration, metrics, checkpoints, and what is made of them."""

import contextlib
import json
import os
import shutil
from pathlib import Path
from typing import Any

import numpy as np

from ailsrs_jax.errors import UserError
from tests.fuzz.mutations import Rng, make_csv, mutate_bytes, mutated_json


def config() -> Any:
    from ailsrs_jax.data.sources import Source
    from ailsrs_jax.runs.storage.config import RunConfig
    from ailsrs_jax.trainers.algorithms import preset_settings

    return RunConfig(
        env_id="Swimmer-v5",
        physics="mujoco",
        seeds=(0, 5),
        algorithm="ailsrs",
        preset="tuned",
        settings=preset_settings("Swimmer-v5", "tuned"),
        num_trajectories=10,
        source=Source("file", "nobody's.npz"),
        demonstrations_sha256="0" * 64,
        subsample=1,
    )


def read_config(path: Path) -> object:
    from ailsrs_jax.runs.storage import config as configs

    return config().require_same(configs.read_config(path), path)


def make_config(path: Path, rng: Rng) -> None:
    path.write_bytes(mutated_json(config().as_json(), rng))


def make_metrics(path: Path, rng: Rng) -> None:
    rows: list[list[Any]] = [["iteration", "seed", "env_steps", "evaluation_return"]]
    rows += [[i, seed, 80 * i, rng.random()] for i in range(4) for seed in (0, 5)]
    make_csv(rows, path, rng)


def read_metrics(path: Path) -> object:
    from ailsrs_jax.runs.storage import metrics

    with contextlib.suppress(UserError):  # one of its readers is enough to refuse it
        metrics.CsvFile(path, [(i, seed) for i in range(3) for seed in (0, 5)])
    return metrics.read_metrics(path)


def make_run(path: Path, rng: Rng) -> None:
    """What ``ailsrs report`` reads of a run, its configuration or its metrics damaged."""
    path.mkdir()
    columns = ["iteration", "seed", "env_steps", "evaluation_return", "expert_distance"]
    rows = [columns, *([i, seed, 80 * i, 1.5, rng.random()] for i in range(4) for seed in (0, 5))]
    whole = json.dumps(config().as_json()).encode()
    damaged = mutated_json(config().as_json(), rng) if rng.random() < 0.6 else whole
    (path / "config.json").write_bytes(damaged)
    result = {"command": "ailsrs train swimmer", "expert_return": {"mean": 1.0, "std": 0.0}}
    result["seeds"] = {"5": {"kept_iteration": 2, "score": -0.5}}
    whole = json.dumps(result).encode()
    (path / "result.json").write_bytes(mutated_json(result, rng) if rng.random() < 0.5 else whole)
    make_csv(rows, path / "metrics.csv", rng)


def read_card(path: Path) -> object:
    from ailsrs_jax.data.policies import expert_path, load_policy
    from ailsrs_jax.runs.evaluation import Evaluation
    from ailsrs_jax.show.model_card import find_origin, model_card

    policy = load_policy(expert_path("Swimmer-v5"))
    origin = find_origin(policy, path / "seed_5" / "policy.npz")
    card = model_card(policy, Evaluation(np.ones(2), np.ones(2)), "here", origin, "mit")
    assert all(line.isprintable() for line in card.split("\n"))
    return card.encode()


def read_saved_run(path: Path) -> object:
    from ailsrs_jax.runs.storage.saved_run import read_run

    run = read_run(path)
    return run.kept_iterations, run.command, run.expert_return, run.changed_settings()


def checkpoint_state() -> Any:
    return {"weights": np.arange(12.0).reshape(3, 4), "steps": np.array([3])}


def make_checkpoints(path: Path, rng: Rng) -> None:
    """The newest of two is damaged, half of the time with hashes that match the damage."""
    from ailsrs_jax.runs.storage import checkpoint

    original = Path(os.environ["MINARI_DATASETS_PATH"]) / "checkpoints"
    if not original.exists():
        with checkpoint.Checkpoints(original, 1, {"env_id": "Hopper-v5"}) as checkpoints:
            for num_done in (1, 2):
                checkpoints.save(num_done, checkpoint_state())
    shutil.copytree(original, path)
    newest = path / "2"
    files = [file for file in sorted(newest.rglob("*")) if file.is_file()]
    for file in rng.sample(files, rng.choice([1, 1, 2])):
        match rng.randrange(5):
            case 0:
                file.unlink()
            case 1:
                other = rng.choice([other for other in files if other.exists()])
                file.write_bytes(other.read_bytes())
            case _:
                file.write_bytes(mutate_bytes(file.read_bytes(), rng))
    if rng.random() < 0.5:
        (newest / checkpoint.HASHES).write_text(checkpoint._hashes(newest))


def read_checkpoints(path: Path) -> object:
    from ailsrs_jax.runs.storage.checkpoint import Checkpoints

    with Checkpoints(path, 1) as checkpoints:
        return checkpoints.restore(checkpoint_state()).num_done
