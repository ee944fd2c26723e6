"""A run that is read from its files alone."""

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ailsrs_jax.data.demonstrations import Demonstrations, save_demonstrations
from ailsrs_jax.data.sources import Source
from ailsrs_jax.errors import UserError
from ailsrs_jax.runs.plan import plan
from ailsrs_jax.runs.spec import RunSpec
from ailsrs_jax.runs.storage.journal import Result
from ailsrs_jax.runs.storage.metrics import read_metrics
from ailsrs_jax.runs.storage.saved_run import read_run
from tests.runs import toy_run

POINT_MASS = "tests.point_mass:PointMass"
SETTINGS = {"num_iterations": 3, "episode_length": 20, "gradient_steps": 5}


@pytest.fixture(scope="module")
def trained(
    tmp_path_factory: pytest.TempPathFactory, point_mass_expert: Demonstrations
) -> tuple[Path, Result]:
    """A run of behaviour cloning with two seeds, from a file."""
    folder = tmp_path_factory.mktemp("saved")
    save_demonstrations(point_mass_expert.replace(env_id=POINT_MASS), folder / "mine.npz")
    spec = RunSpec(
        POINT_MASS, folder / "mine.npz", "bc", seeds=(0, 5), subsample=2, settings=SETTINGS
    )
    return folder / "run", toy_run.run(plan(spec), folder / "run")


def test_it_knows_what_the_run_knew(trained: tuple[Path, Result]) -> None:
    directory, result = trained
    run = read_run(directory)
    file = str(directory.parent / "mine.npz")
    assert (run.title, run.imitates) == ("BC", True)
    assert run.source == result.config.source == Source("file", file)
    assert run.kept_iterations == result.kept_iterations
    assert run.expert_return == pytest.approx(np.mean(result.expert_returns))
    assert run.changed_settings() == SETTINGS
    assert run.command == (
        f"ailsrs train {POINT_MASS} --demonstrations {file} --algorithm bc --subsample 2 "
        "--seeds 0 5 --set episode_length=20 gradient_steps=5 num_iterations=3"
    )
    public = run.without_folder()
    assert public.source == Source("file", "mine.npz")
    assert public.config["source"]["name"] == "mine.npz"
    assert str(directory.parent) not in str(public.command)


def test_result_and_times_are_written(trained: tuple[Path, Result]) -> None:
    directory, result = trained
    fields = json.loads((directory / "result.json").read_text())
    metrics, times = (read_metrics(directory / f"{name}.csv") for name in ("metrics", "seconds"))
    assert fields["finished"]
    assert fields["env_steps"] == {
        str(seed): metrics["env_steps"][metrics["seed"] == seed][-1] for seed in (0, 5)
    }
    assert times["iteration"].tolist() == [0, 1, 2]
    assert times["compile_seconds"][0] > 0
    assert times["compile_seconds"][1:].tolist() == [0, 0]
    total = times["seconds"].sum() + times["compile_seconds"].sum()
    assert fields["seconds"] == pytest.approx(total)
    for seed, kept in fields["seeds"].items():
        losses = metrics["validation_loss"][metrics["seed"] == int(seed)]
        assert kept["kept_iteration"] == result.kept_iterations[int(seed)] == np.argmin(losses)
        assert kept["score"] == pytest.approx(-losses.min(), rel=1e-6)


DAMAGED: dict[str, dict[str, Any]] = {
    "'expert_return'": {"expert_return": ...},
    "ValueError: expert_return": {"expert_return": {"mean": float("nan")}},
    "ValueError: seeds": {"seeds": {"7": {"kept_iteration": 0}}},
    "is not the result of a run": {"seeds": [0]},
    "'kept_iteration'": {"seeds": {"0": {}}},
    "ValueError: command": {"command": "ailsrs train hopper; rm -rf ~"},
    "is not the result": {"command": "rm -rf ~"},
    "AttributeError": {"command": 3},
}


@pytest.mark.parametrize(("message", "changes"), DAMAGED.items())
def test_a_damaged_result_is_one_line(
    message: str, changes: dict[str, Any], trained: tuple[Path, Result], tmp_path: Path
) -> None:
    shutil.copytree(trained[0], tmp_path / "run")
    path = tmp_path / "run" / "result.json"
    fields = json.loads(path.read_text()) | changes
    path.write_text(json.dumps({k: v for k, v in fields.items() if v is not ...}))
    with pytest.raises(UserError) as caught:
        read_run(tmp_path / "run")
    assert message in str(caught.value)


@pytest.mark.parametrize(
    "changes",
    [{"num_trajectories": 0}, {"num_trajectories": None}, {"subsample": -1}, {"source": None}],
)
def test_a_damaged_configuration_is_one_line(
    changes: dict[str, Any], trained: tuple[Path, Result], tmp_path: Path
) -> None:
    shutil.copytree(trained[0], tmp_path / "run")
    path = tmp_path / "run" / "config.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | changes))
    with pytest.raises(UserError, match=r"is not the configuration of a run: .* is"):
        read_run(tmp_path / "run")


def test_a_run_of_an_older_version_is_refused(trained: tuple[Path, Result], tmp_path: Path) -> None:
    shutil.copytree(trained[0], tmp_path / "run")
    path = tmp_path / "run" / "config.json"
    fields = json.loads(path.read_text())
    del fields["source"]
    path.write_text(json.dumps(fields | {"demonstrations": "mine.npz"}))
    for read in (read_run, lambda run: trained[1].config.require_same(fields_of(run), path)):
        with pytest.raises(UserError, match="was written by an older version"):
            read(tmp_path / "run")


def fields_of(run: Path) -> Any:
    return json.loads((run / "config.json").read_text())


def test_an_algorithm_of_ones_own_is_not_imported(
    trained: tuple[Path, Result], tmp_path: Path
) -> None:
    shutil.copytree(trained[0], tmp_path / "run")
    path = tmp_path / "run" / "config.json"
    path.write_text(json.dumps(fields_of(tmp_path / "run") | {"algorithm": "evil:make"}))
    run = read_run(tmp_path / "run")
    assert run.title == "evil:make"
    assert run.changed_settings().keys() == run.config["settings"].keys()
