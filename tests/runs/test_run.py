import csv
import dataclasses
import itertools
import json
import os
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest

from ailsrs_jax.data.demonstrations import Demonstrations, save_demonstrations
from ailsrs_jax.data.policies import load_policy
from ailsrs_jax.data.sources import Source
from ailsrs_jax.errors import UserError
from ailsrs_jax.runs import loop, run
from ailsrs_jax.runs.iterations import iterate
from ailsrs_jax.runs.plan import Plan, plan
from ailsrs_jax.runs.spec import RunSpec
from ailsrs_jax.runs.storage.config import read_config
from ailsrs_jax.runs.storage.directory import claimed
from ailsrs_jax.runs.storage.journal import Result
from ailsrs_jax.runs.storage.metrics import IterationReport
from ailsrs_jax.trainers.parts.rollout import Simulator
from tests.point_mass import noise
from tests.runs import toy_run

SETTINGS = {
    "num_iterations": 12,
    "num_directions": 2,
    "num_top_directions": 2,
    "episode_length": 10,
    "discriminator_batch_size": 16,
    "memory_samples": 16,
    "num_distance_samples": 50,
}


def swimmer_demonstrations() -> Demonstrations:
    made = noise(8, 2, [10, 10, 10], "Swimmer-v5")
    return made.replace(returns=np.array([1.0, 2.0, 3.0], np.float32))


def make_plan(**changes: Any) -> Plan:
    fields: dict[str, Any] = {
        "env": "swimmer",
        "demonstrations": swimmer_demonstrations(),
        "num_trajectories": 2,
        "seeds": (0, 5),
        "physics": "mujoco",
        "settings": SETTINGS,
    }
    return plan(RunSpec(**(fields | changes)))


def toy_plan(**settings: Any) -> Plan:
    """A run of AILSRS on the point mass and one device, which compiles fast."""
    made = toy_run.plan(12, "ailsrs", **settings)
    return dataclasses.replace(made, simulator=Simulator(made.simulator.env))


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Result]:
    directory = tmp_path_factory.mktemp("run") / "whole"
    return directory, toy_run.run(toy_plan(), directory)


def read_rows(directory: Path) -> list[dict[str, str]]:
    with (directory / "metrics.csv").open() as file:
        return list(csv.DictReader(file))


def test_directory_holds_what_is_promised(finished: tuple[Path, Result]) -> None:
    directory, result = finished
    config = json.loads((directory / "config.json").read_text())
    assert config["env_id"] == "PointMass"
    assert config["seeds"] == [0, 5]
    assert config["settings"]["num_directions"] == 4
    assert config["versions"]["jax"] == jax.__version__
    assert config["source"] == vars(Source("memory"))

    rows = read_rows(directory)
    assert [(row["iteration"], row["seed"]) for row in rows] == [
        (str(iteration), seed) for iteration in range(12) for seed in ("0", "5")
    ]
    for seed, policy in result.policies.items():
        saved = load_policy(directory / f"seed_{seed}" / "policy.npz")
        np.testing.assert_array_equal(saved.weights, policy.weights)
        distances = [float(r["expert_distance"]) for r in rows if r["seed"] == str(seed)]
        assert result.kept_iterations[seed] == int(np.argmin(distances))
        stored = {
            int(path.stem): load_policy(path)
            for path in (directory / f"seed_{seed}" / "iterations").iterdir()
        }
        assert sorted(stored) == [0, 1, 2, 3, 4, 6, 8]
        if result.kept_iterations[seed] in stored:
            same = stored[result.kept_iterations[seed]]
            np.testing.assert_array_equal(same.weights, policy.weights)
    assert result.expert_returns is not None
    assert result.expert_returns.tolist() == [1.0, 1.0, 1.0]


def test_the_last_whole_iteration_is_saved_when_the_environment_fails(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def failing(*arguments: Any, **options: Any) -> Iterator[Any]:
        yield from itertools.islice(iterate(*arguments, **options), 5)
        raise UserError("the simulator is gone")

    monkeypatch.setattr(loop, "iterate", failing)
    with pytest.raises(UserError, match="the simulator is gone"):
        toy_run.run(toy_plan(), tmp_path / "run")
    monkeypatch.undo()
    assert (tmp_path / "run" / "checkpoints" / "5").exists()
    assert len(read_rows(tmp_path / "run")) == 2 * 5


def test_a_folder_that_looks_like_a_partial_file_stays(tmp_path: Path) -> None:
    (tmp_path / ".a.partial").mkdir()
    (tmp_path / ".b.partial").touch()
    with claimed(tmp_path, toy_plan().config, resume=False):
        assert (tmp_path / ".a.partial").is_dir()
        assert not (tmp_path / ".b.partial").exists()


def test_interrupted_and_resumed_is_bitwise_the_same(
    finished: tuple[Path, Result], tmp_path: Path
) -> None:
    directory, result = finished

    class KilledError(Exception):
        pass

    def kill(report: IterationReport) -> None:
        assert load_policy(interrupted / "seed_5" / "policy.npz").env_id == "PointMass"
        if report.iteration == 10:  # after the checkpoint, so its row has to be dropped
            raise KilledError

    interrupted = tmp_path / "interrupted"
    with pytest.raises(KilledError):
        toy_run.run(toy_plan(), interrupted, watch=kill)
    assert not json.loads((interrupted / "result.json").read_text())["finished"]
    assert len((interrupted / "seconds.csv").read_text().splitlines()) == 1 + 11
    resumed = toy_run.run(toy_plan(), interrupted, resume=True)
    assert (interrupted / "metrics.csv").read_bytes() == (directory / "metrics.csv").read_bytes()
    assert len((interrupted / "seconds.csv").read_text().splitlines()) == 1 + 12
    for seed, policy in result.policies.items():
        np.testing.assert_array_equal(resumed.policies[seed].weights, policy.weights)
        np.testing.assert_array_equal(resumed.policies[seed].mean, policy.mean)
    assert resumed.kept_iterations == result.kept_iterations
    for path in directory.glob("seed_*/iterations/*"):
        again = interrupted / path.relative_to(directory)
        assert again.read_bytes() == path.read_bytes()
    before, after = (
        json.loads((run / "result.json").read_text()) for run in (directory, interrupted)
    )
    assert before | {"seconds": 0} == after | {"seconds": 0}


def test_the_same_command_gives_the_same_bits(tmp_path: Path) -> None:
    """Also with the C engine, whose threads simulate in any order, and when compiled again."""
    made = make_plan(settings=SETTINGS | {"num_iterations": 2})
    for name in ("once", "again"):
        toy_run.run(made, tmp_path / name)
    names = ("metrics.csv", "config.json", "seed_0/policy.npz", "seed_5/policy.npz")
    for name in names:
        once, again = ((tmp_path / run / name).read_bytes() for run in ("once", "again"))
        assert once == again, name
    # 2N perturbed episodes and the evaluation episodes; the swimmer's never end early.
    settings = made.config.settings
    episodes = settings.updates_per_iteration * 2 * 2 + settings.num_evaluation_episodes
    steps = [int(row["env_steps"]) for row in read_rows(tmp_path / "once")[::2]]
    assert steps == [10 * episodes, 2 * 10 * episodes]


def test_resuming_a_finished_run_changes_nothing(
    finished: tuple[Path, Result], tmp_path: Path
) -> None:
    directory, result = finished
    copy = tmp_path / "copy"
    shutil.copytree(directory, copy)
    again = toy_run.run(toy_plan(), copy, resume=True)
    for name in ("metrics.csv", "seconds.csv"):
        assert (copy / name).read_bytes() == (directory / name).read_bytes()
    np.testing.assert_array_equal(again.policies[5].weights, result.policies[5].weights)
    shutil.rmtree(copy / "checkpoints")
    with pytest.raises(UserError, match="has a result but no checkpoints"):
        toy_run.run(toy_plan(), copy, resume=True)
    assert (copy / "metrics.csv").read_bytes() == (directory / "metrics.csv").read_bytes()


def test_another_run_is_never_overwritten_or_continued(
    finished: tuple[Path, Result], tmp_path: Path
) -> None:
    directory, _ = finished
    with pytest.raises(UserError, match="not empty: add --resume"):
        toy_run.run(toy_plan(), directory)
    changed = toy_plan(noise_std=0.5)
    with pytest.raises(UserError, match=r"settings\.noise_std is 0\.5, was"):
        toy_run.run(changed, directory, resume=True)
    with pytest.raises(UserError, match="resume needs output"):
        toy_run.run(toy_plan(), resume=True)
    with pytest.raises(UserError, match="nothing to resume"):
        toy_run.run(toy_plan(), tmp_path / "nowhere", resume=True)


@pytest.mark.parametrize("kind", ["link", "pipe"])
def test_a_lock_that_is_something_else_is_left_alone(kind: str, tmp_path: Path) -> None:
    precious, lock = tmp_path / "precious", tmp_path / "run" / ".lock"
    precious.write_text("all I have")
    lock.parent.mkdir()
    config = toy_plan().config
    if kind == "link":
        lock.symlink_to(precious)
        with (
            pytest.raises(UserError, match="cannot write"),
            claimed(lock.parent, config, resume=False),
        ):
            pass
    else:
        os.mkfifo(lock)
        with claimed(lock.parent, config, resume=False):
            pass
    assert precious.read_text() == "all I have"


def test_other_versions_and_lost_rows_are_refused(
    finished: tuple[Path, Result], tmp_path: Path
) -> None:
    copy = tmp_path / "copy"
    shutil.copytree(finished[0], copy)
    config = json.loads((copy / "config.json").read_text())
    config["versions"]["jax"] = "0.1.2"
    (copy / "config.json").write_text(json.dumps(config))
    with pytest.raises(
        UserError, match=r"versions\.jax is '.*', was '0\.1\.2'; install those versions, or edit"
    ):
        toy_run.run(toy_plan(), copy, resume=True)

    changed = toy_plan(noise_std=0.5)
    changed.config.save(copy / "config.json")
    with pytest.raises(UserError, match=r"settings\.noise_std is 0\.5, was"):
        toy_run.run(changed, copy, resume=True)  # the checkpoints are of another run

    shutil.copy(finished[0] / "config.json", copy)
    rows = (copy / "metrics.csv").read_text().splitlines(keepends=True)
    for damaged in (rows[:7] + rows[8:], rows[:-1], rows[:8] + rows[7:], [rows[0][:30], *rows[1:]]):
        (copy / "metrics.csv").write_text("".join(damaged))
        with pytest.raises(UserError, match="lacks rows of the 12 iterations done"):
            toy_run.run(toy_plan(), copy, resume=True)


def test_python_api_writes_nothing_unless_asked(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    settings = SETTINGS | {"num_iterations": 1}
    seen: list[int] = []
    result = run.train(
        "swimmer",
        swimmer_demonstrations(),
        num_trajectories=3,
        watch=lambda report: seen.append(report.iteration),
        **settings,
    )
    assert seen == [0]
    assert result.policies[0].env_id == "Swimmer-v5"
    assert not list(tmp_path.iterdir())


WRONG = {
    "unknown environment 'hoper'": {"env": "hoper"},
    "unknown preset 'best'": {"preset": "best"},
    "unknown physics 'bullet'": {"physics": "bullet"},
    "seeds are [1, 1]": {"seeds": (1, 1)},
    "seeds are []": {"seeds": ()},
    "seed is -1: it must be from 0": {"seeds": (-1,)},
    "seed is 2147483648: it must be from 0": {"seeds": (2**31,)},
    "hold 3": {"num_trajectories": 4},
    "are of Swimmer-v5, not of Hopper-v5": {"env": "hopper"},
    "no such file": {"demonstrations": "missing.npz"},
    "there is no setting 'learning_rate'": {"settings": {"learning_rate": 1}},
    "num_top_directions is 9: it must be at most num_directions": {
        "settings": {"num_directions": 8, "num_top_directions": 9}
    },
    "noise_std is 0.0: it must be positive": {"settings": {"noise_std": 0}},
    "rollout_batch_size is for random search": {"algorithm": "bc", "rollout_batch_size": 8},
}


@pytest.mark.parametrize(("message", "change"), WRONG.items())
def test_mistakes_are_found_before_anything_runs(message: str, change: dict[str, Any]) -> None:
    with pytest.raises(UserError) as caught:
        make_plan(**change)
    assert message in str(caught.value)


def test_demonstrations_in_memory_are_checked_like_files() -> None:
    broken = swimmer_demonstrations()
    broken.actions[1, 2] = np.nan
    with pytest.raises(UserError, match="handed in: actions hold NaN"):
        make_plan(demonstrations=broken)
    padded = swimmer_demonstrations().replace(lengths=np.array([10, 4, 10]))
    padded.observations[1, 4:] = np.nan  # after the episode's end, where values are ignored
    assert np.isfinite(make_plan(demonstrations=padded).data.demonstrations.observations).all()


def test_a_name_of_any_bytes_can_be_written_down(tmp_path: Path) -> None:
    path = tmp_path / os.fsdecode(b"d\xe9mos.npz")
    save_demonstrations(swimmer_demonstrations(), path)
    config = make_plan(demonstrations=path).config
    config.save(tmp_path / "config.json")
    config.require_same(read_config(tmp_path / "config.json"), tmp_path / "config.json")
    assert config.source == Source("file", str(tmp_path / r"d\xe9mos.npz"))


def test_all_demonstrations_of_ones_own_are_used_unless_told() -> None:
    assert make_plan(num_trajectories=None).config.num_trajectories == 3


def test_demonstrations_must_fit_the_task() -> None:
    wide = swimmer_demonstrations().replace(observations=np.zeros((3, 10, 9), np.float32))
    with pytest.raises(UserError, match="9 observations and 2 actions"):
        make_plan(demonstrations=wide)
