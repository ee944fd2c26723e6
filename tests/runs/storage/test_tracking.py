"""TensorBoard's events and trackers: they have the rows of metrics.csv, and cannot stop a run."""

import errno
import itertools
import json
import logging
import os
import shutil
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
from tensorboardX.record_writer import RecordWriter

from ailsrs_jax.errors import UserError
from ailsrs_jax.runs.plan import Plan
from ailsrs_jax.runs.storage import tensorboard, trackers
from ailsrs_jax.runs.storage.journal import Journal
from ailsrs_jax.runs.storage.metrics import IterationReport, read_metrics, read_rows
from ailsrs_jax.runs.storage.tensorboard import GROUP
from ailsrs_jax.runs.storage.trackers import Tracker
from ailsrs_jax.sweeps.sweep import sweep
from tests.runs import toy_run


class KilledError(Exception):
    pass


def kill_at(iteration: int) -> Callable[[Any], None]:
    def watch(report: Any) -> None:
        if report.iteration == iteration:
            raise KilledError

    return watch


def events(directory: Path) -> EventAccumulator:
    return EventAccumulator(str(directory), size_guidance={"scalars": 0}).Reload()


def require_events(output: Path, seeds: tuple[int, ...]) -> None:
    """Require that TensorBoard reads the numbers of ``metrics.csv`` from the events of a run."""
    columns = read_metrics(output / "metrics.csv")
    for seed in seeds:
        read = events(output / f"seed_{seed}")
        mine = columns["seed"] == seed
        for name in columns.keys() - {"iteration", "seed"}:
            points = read.Scalars(GROUP + name)
            np.testing.assert_array_equal(
                [point.step for point in points], columns["env_steps"][mine]
            )
            values = np.array([point.value for point in points])
            np.testing.assert_array_equal(values, columns[name][mine].astype(np.float32))
        assert len(read.Scalars(f"{GROUP}env_steps_per_second")) == mine.sum()


# A stand-in for Trackio's client. It writes to the file LOG and fails at the point FAULT.
LIBRARY = """
import json, os, pathlib

def do(point):
    print("noise", flush=True)
    if os.environ.get("FAULT") == point:
        raise RuntimeError("no\\nnetwork")

do("import")

class Run:
    def __init__(self, name, config):
        self.name = name
        self.log_file = pathlib.Path(os.environ["LOG"])
        lines = self.log_file.read_text().splitlines() if self.log_file.exists() else []
        entries = [json.loads(line) for line in lines]
        mine = [entry["step"] for entry in entries if entry["name"] == name]
        self._next_step = max(mine, default=-1) + 1
        assert config["seed"] == int(name.split("seed_")[1].split()[0])

    def log(self, data, step):
        do("log")
        with self.log_file.open("a") as file:
            file.write(json.dumps({"name": self.name, "step": step, "data": data}) + "\\n")

    def finish(self):
        do("finish")

def init(*, name, config, **_):
    do("init")
    return Run(name, config)
"""


@pytest.fixture(scope="module")
def plan() -> Iterator[Plan]:
    plan = toy_run.plan(12, "ars")
    name = "jax_persistent_cache_min_compile_time_secs"
    before = jax.config.values[name]
    jax.config.update(name, 0.0)  # to compile once for all of these runs
    yield plan
    jax.config.update(name, before)


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Install the stand-in under the name of Trackio, and return the file that it writes to."""
    directory = tmp_path_factory.mktemp("library")
    (directory / "trackio.py").write_text(LIBRARY)
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(directory)
        patch.delitem(sys.modules, "trackio", raising=False)
        patch.setenv("LOG", str(directory / "log"))
        yield directory / "log"
        sys.modules.pop("trackio", None)


@pytest.fixture(scope="module")
def undisturbed(plan: Plan, tmp_path_factory: pytest.TempPathFactory) -> Path:
    output = tmp_path_factory.mktemp("undisturbed") / "run"
    toy_run.run(plan, output)
    return output


@pytest.fixture(scope="module")
def resumed(plan: Plan, library: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run killed two iterations after a checkpoint, whose tracker failed until then."""
    output = tmp_path_factory.mktemp("resumed") / "run"
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("FAULT", "log")
        with pytest.raises(KilledError):
            toy_run.run(plan, output, checkpoint_every=3, watch=kill_at(7), track="trackio")
    newest = max((output / "seed_0").glob("events*"))
    newest.write_bytes(newest.read_bytes()[:-7])  # as after a loss of power
    toy_run.run(plan, output, checkpoint_every=3, resume=True, track="trackio")
    return output


def test_the_run_is_the_same_whatever_is_tracked(undisturbed: Path, resumed: Path) -> None:
    for name in ("config.json", "metrics.csv", "seed_0/policy.npz", "seed_5/policy.npz"):
        assert (resumed / name).read_bytes() == (undisturbed / name).read_bytes(), name


def test_tensorboard_reads_what_metrics_csv_holds(undisturbed: Path, resumed: Path) -> None:
    """No point is lost or doubled, although two processes wrote the events."""
    assert len(list((resumed / "seed_0").glob("events.out.tfevents.*"))) == 2
    for output in (undisturbed, resumed):
        require_events(output, toy_run.SEEDS)


def test_tensorboard_knows_the_settings(resumed: Path) -> None:
    read = events(resumed / "seed_5")
    text = read.Tensors("config/text_summary")[-1].tensor_proto.string_val[0].decode()
    config = json.loads((resumed / "config.json").read_text())
    about = json.loads(text.strip("`\n"))
    assert about == {k: v for k, v in config.items() if k != "seeds"} | {"seed": 5}
    started = read.summary_metadata["_hparams_/session_start_info"].plugin_data
    assert started.plugin_name == "hparams"
    for name in (b"noise_std", b"num_directions", b"env_id", b"PointMass"):
        assert name in started.content


def append_thrice(output: Path, plan: Plan) -> None:
    """Write three iterations, and require that metrics.csv has all of their rows."""
    journal = Journal(output, plan.config, 0, [0, 0])
    for iteration in range(3):
        metrics = {"env_steps": np.full(2, iteration + 1), "evaluation_return": np.ones(2)}
        journal.append(IterationReport(iteration, 3, metrics, 1.0, 1.0, None))
    journal.close()
    assert len(read_rows(output / "metrics.csv")) == 1 + 3 * 2


@pytest.mark.parametrize("num_written", [6, 11])  # in the second seed's first events; later
def test_events_that_cannot_be_written_are_done_without(
    num_written: int, plan: Plan, tmp_path: Path, monkeypatch, caplog
) -> None:
    calls = itertools.count()

    def fail(*_: Any, **__: Any) -> None:
        if next(calls) >= num_written:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(tensorboard, "_write", fail)
    append_thrice(tmp_path, plan)
    assert [record.getMessage() for record in caplog.records] == [
        "no more events for TensorBoard: No space left on device"
    ]


def test_a_full_disk_stops_only_the_events(plan: Plan, tmp_path: Path, monkeypatch, caplog) -> None:
    if not Path("/dev/full").exists():
        pytest.skip("there is no /dev/full")
    monkeypatch.setattr(tensorboard, "_new_file", lambda _: RecordWriter("/dev/full"))
    append_thrice(tmp_path, plan)
    assert [record.getMessage() for record in caplog.records] == [
        "no more events for TensorBoard: No space left on device"
    ]


def test_a_tracker_gets_every_row_once(library: Path, resumed: Path) -> None:
    """The tracker gets the rows that it failed to take, and no row twice."""
    sent = [json.loads(line) for line in library.read_text().splitlines()]
    names = dict.fromkeys(entry["name"] for entry in sent)
    assert [name.rpartition(" ")[0] for name in names] == ["run/seed_0", "run/seed_5"]
    header, *rows = read_rows(resumed / "metrics.csv")
    for seed, name in zip(toy_run.SEEDS, names, strict=True):
        mine = [entry for entry in sent if entry["name"] == name]
        expected = [
            {k: float(v) for k, v in zip(header[2:], row[2:], strict=True)}
            for row in rows
            if row[1] == str(seed)
        ]
        assert [entry["step"] for entry in mine] == list(range(12))
        assert [entry["data"] for entry in mine] == expected


def test_a_tracker_goes_on_where_it_was(library: Path, tmp_path: Path, resumed: Path) -> None:
    """A tracker takes the rows that it lacks, and ignores rows that are written again."""
    output = tmp_path / "again"
    shutil.copytree(resumed, output)
    lines = (resumed / "metrics.csv").read_bytes().splitlines(keepends=True)
    before = library.stat().st_size
    for num_lines in (15, 11, 25):  # the header and two of each iteration
        (output / "metrics.csv").write_bytes(b"".join(lines[:num_lines]))
        Tracker("trackio", output).close()
    sent = [json.loads(line) for line in library.read_bytes()[before:].splitlines()]
    for name in {entry["name"] for entry in sent}:
        assert [entry["step"] for entry in sent if entry["name"] == name] == list(range(12))


@pytest.mark.parametrize("fault", ["import", "init", "log", "finish"])
def test_an_error_of_a_tracker_is_one_warning(
    fault: str, library: Path, resumed: Path, tmp_path: Path, monkeypatch, caplog, capsys
) -> None:
    monkeypatch.delitem(sys.modules, "trackio", raising=False)
    monkeypatch.setenv("LOG", str(tmp_path / "log"))
    monkeypatch.setenv("FAULT", fault)
    tracker = Tracker("trackio", resumed)
    report = IterationReport(12, 13, {"env_steps": np.ones(2)}, 1.0, 1.0, None)
    tracker.append(report)
    tracker.close()
    tracker.append(report)
    tracker.close()
    assert [(record.levelno, record.getMessage()) for record in caplog.records] == [
        (logging.WARNING, "no longer tracked by trackio: RuntimeError: no")
    ]
    assert capsys.readouterr().out == ""


def test_a_link_is_not_written_through(
    library: Path, resumed: Path, tmp_path: Path, caplog
) -> None:
    run = shutil.copytree(resumed, tmp_path / "run")
    precious = tmp_path / "precious"
    precious.write_text("mine")
    (run / trackers.ID_FILE).unlink()
    (run / trackers.ID_FILE).symlink_to(precious)
    Tracker("trackio", run).close()
    assert "is not a file of this program" in caplog.text
    assert precious.read_text() == "mine"


def test_a_tracker_that_cannot_be_is_refused_before_anything_is_written(
    plan: Plan, in_tmp_path: Path, monkeypatch
) -> None:
    Path("elsewhere").mkdir()  # Weights & Biases leaves such a directory, named wandb
    monkeypatch.syspath_prepend("")
    monkeypatch.setitem(trackers.TRACKERS, "elsewhere", trackers.open_trackio)
    monkeypatch.setitem(sys.modules, "wandb", None)  # not installed
    for track, message in {
        "mlflow": "unknown tracker 'mlflow': use wandb or trackio",
        "wandb": r"tracking with wandb needs pip install 'ailsrs_jax\[wandb\]'",
        "elsewhere": "tracking with elsewhere needs pip install",
    }.items():
        with pytest.raises(UserError, match=message):
            toy_run.run(plan, Path("run"), track=track)
        with pytest.raises(UserError, match=message):
            sweep({"grid": [{"env": "hopper", "algorithm": "ars"}]}, "run", track=track)
    with pytest.raises(UserError, match="track needs output"):
        toy_run.run(plan, track="wandb")
    assert [path.name for path in Path().iterdir()] == ["elsewhere"]
