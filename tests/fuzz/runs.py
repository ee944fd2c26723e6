"""Damaged files of a run: configuration, metrics, results and checkpoints."""

import contextlib
import functools
import os
import shutil
from pathlib import Path
from typing import Any

import numpy as np
from hypothesis import strategies as st

from ailsrs_jax.errors import UserError
from tests.fuzz.damage import damaged_bytes, write_damaged


@functools.cache
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


def make_run(draw: st.DrawFn, path: Path) -> None:
    """The files of a run that ``ailsrs report`` reads."""
    columns = ["iteration", "seed", "env_steps", "evaluation_return", "expert_distance"]
    rows = [columns, *([i, seed, 80 * i, 1.5, 0.3 * i] for i in range(4) for seed in (0, 5))]
    result = {
        "command": "ailsrs train swimmer",
        "expert_return": {"mean": 1.0, "std": 0.0},
        "seeds": {"5": {"kept_iteration": 2, "score": -0.5}},
    }
    files = {"config.json": config().as_json(), "metrics.csv": rows, "result.json": result}
    write_damaged(draw, path, files)


@functools.cache
def expert() -> Any:
    from ailsrs_jax.data.policies import expert_path, load_policy

    return load_policy(expert_path("Swimmer-v5"))


def read_files_of_run(path: Path) -> object:
    """Read the run with every function that reads it."""
    from ailsrs_jax.runs.evaluation import Evaluation
    from ailsrs_jax.runs.storage.config import read_config
    from ailsrs_jax.runs.storage.metrics import CsvFile
    from ailsrs_jax.runs.storage.saved_run import read_run
    from ailsrs_jax.show.model_card import find_origin, model_card

    policy = expert()
    origin = find_origin(policy, path / "seed_5" / "policy.npz")
    card = model_card(policy, Evaluation(np.ones(2), np.ones(2)), "here", origin, "mit")
    assert all(line.isprintable() for line in card.split("\n"))
    card.encode()
    with contextlib.suppress(UserError):
        config().require_same(read_config(path / "config.json"), path)
    with contextlib.suppress(UserError):
        CsvFile(path / "metrics.csv", [(i, seed) for i in range(3) for seed in (0, 5)])
    run = read_run(path)
    return run.kept_iterations, run.command, run.expert_return, run.changed_settings()


def checkpoint_state() -> Any:
    return {"weights": np.arange(12.0).reshape(3, 4), "steps": np.array([3])}


def make_checkpoints(draw: st.DrawFn, path: Path) -> None:
    """Two checkpoints; the newest is damaged, half of the time with hashes that match."""
    from ailsrs_jax.runs.storage import checkpoint

    original = Path(os.environ["MINARI_DATASETS_PATH"]) / "checkpoints"
    if not original.exists():
        with checkpoint.Checkpoints(original, 1, {"env_id": "Hopper-v5"}) as checkpoints:
            for num_done in (1, 2):
                checkpoints.save(num_done, checkpoint_state())
    shutil.copytree(original, path)
    newest = path / "2"
    files = [file for file in sorted(newest.rglob("*")) if file.is_file()]
    for file in draw(st.lists(st.sampled_from(files), min_size=1, max_size=2, unique=True)):
        match draw(st.integers(0, 4)):
            case 0:
                file.unlink()
            case 1:
                shutil.copyfile(draw(st.sampled_from([x for x in files if x.exists()])), path / "x")
                (path / "x").replace(file)
            case _:
                file.write_bytes(draw(damaged_bytes(file.read_bytes())))
    if draw(st.booleans()):
        (newest / checkpoint.HASHES).write_text(checkpoint._hashes(newest))


def read_checkpoints(path: Path) -> object:
    from ailsrs_jax.runs.storage.checkpoint import Checkpoints

    with Checkpoints(path, 1) as checkpoints:
        return checkpoints.restore(checkpoint_state()).num_done
