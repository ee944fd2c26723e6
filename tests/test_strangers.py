"""Files of a stranger: whatever names they hold, no code of theirs is run."""

import contextlib
import csv
import dataclasses
import itertools
import json
import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import ailsrs_jax as ail
from ailsrs_jax import own_code
from ailsrs_jax.cli import measure, show
from ailsrs_jax.data.policies import SavedPolicy, expert_path, load_policy
from ailsrs_jax.runs.storage.saved_run import read_run
from ailsrs_jax.show.reports import sweep_page
from ailsrs_jax.sweeps.cells import load_sweep
from ailsrs_jax.sweeps.results import COLUMNS
from ailsrs_jax.sweeps.spec import expand, read_spec
from tests.fuzz.runs import config

EVIL = """
import pathlib
pathlib.Path({trace!r}).write_text("ran")
raise SystemExit  # is no Exception
"""
NAMES = (
    *("evil:Task", "evil:Task.make", "evil:", "evil.sub:Task", "theirs.evil:Task"),
    *("runs.theirs.evil:Task", "numpy.f2py.__main__:x", "os:abort", "evil:__loader__.load_module"),
    *("gymnasium:evil:Hopper-v5", "gymnasium:theirs.evil:Task-v0", "gymnasium:evil:Task"),
    *("gymnasium:evil", "gymnasium:numpy.f2py.__main__:x"),
)


def policy(name: str) -> SavedPolicy:
    expert = load_policy(expert_path("Swimmer-v5"))
    return dataclasses.replace(expert, env_id=name)  # type: ignore[type-var,no-any-return]


def policy_file(name: str) -> Path:
    policy(name).save("policy.npz")
    return Path("policy.npz")


def run(**changes: Any) -> Path:
    """A run directory whose configuration, metrics and policies have the names in ``changes``."""
    directory = Path("runs/theirs")
    fields = config().as_json() | {"seeds": [0]} | changes
    (directory / "config.json").write_text(json.dumps(fields))
    columns = "iteration,seed,env_steps,evaluation_return,expert_distance"
    (directory / "metrics.csv").write_text(f"{columns}\n0,0,80,1,1\n")
    result = {
        "command": "ailsrs train swimmer",
        "expert_return": {"mean": 1.0, "std": 0.0},
        "seeds": {"0": {"kept_iteration": 0, "score": -0.5}},
    }
    (directory / "result.json").write_text(json.dumps(result))
    policy(fields["env_id"]).save(directory / "seed_0" / "policy.npz")
    return directory


def sweep_results(name: str) -> Path:
    """The directory of a sweep, with one run."""
    directory, cell = Path("theirs_sweep"), Path("theirs_sweep/cells/one")
    cell.mkdir(parents=True)
    for path in run(env_id=name).rglob("*"):
        target = cell / path.relative_to("runs/theirs")
        if path.is_dir():
            target.mkdir(exist_ok=True)
        elif path.suffix != ".py":
            target.write_bytes(path.read_bytes())
    row = dict.fromkeys(COLUMNS["results.csv"], "1") | {
        "cell": "one",
        "label": name,
        "env_id": name,
        "algorithm": name,
        "status": "done",
        "settings": f"discriminator_loss={name}",
        "preset": "tuned",
        "physics": "mujoco",
        "states_only": False,
    }
    for file in COLUMNS:
        with (directory / file).open("w") as stream:
            writer = csv.DictWriter(stream, COLUMNS[file], extrasaction="ignore")
            writer.writeheader()
            writer.writerow(row)
    return directory


def spec(lines: str) -> None:
    Path("theirs.toml").write_text(f"[[grid]]\n{lines}\n")
    expand(read_spec(Path("theirs.toml")))


def demonstrations(name: str) -> str:
    steps = np.zeros((1, 5, 8), np.float32), np.zeros((1, 5, 2), np.float32)
    lengths, returns = np.array([5], np.int32), np.ones(1, np.float32)
    ail.save_demonstrations(ail.Demonstrations(*steps, lengths, returns, name), "theirs.npz")
    return "theirs.npz"


def saved_sweep(name: str) -> None:
    expand({"grid": [{"env": "swimmer", "algorithm": "ars"}]}).save(Path("a/sweep.json"))
    text = Path("a/sweep.json").read_text()
    for word in ("Swimmer-v5", "ars", "swimmer"):
        text = text.replace(f'"{word}"', json.dumps(name))
    Path("a/sweep.json").write_text(text)
    load_sweep(Path("a/sweep.json"))


READERS: dict[str, Callable[[str], object]] = {
    "evaluate a policy": lambda name: ail.evaluate(policy(name), 1, "auto"),
    "ailsrs evaluate": lambda name: measure.evaluate(policy_file(name), 1),
    "ailsrs evaluate --physics": lambda name: measure.evaluate(policy_file(name), 1, "auto"),
    "ailsrs evaluate RUN": lambda name: measure.evaluate(run(env_id=name), 1, "auto"),
    "ailsrs render": lambda name: show.render(policy_file(name), Path("video.html")),
    "ailsrs render RUN": lambda name: show.render(run(env_id=name), Path("video.html")),
    "ailsrs export": lambda name: show.export(policy_file(name), Path("out"), 1, "auto"),
    "ailsrs export FILE": lambda name: show.export(policy_file(name), Path("out.safetensors")),
    "demonstrate": lambda name: ail.demonstrate(policy(name), 1),
    "ailsrs report, environment": lambda name: show.report(run(env_id=name)),
    "ailsrs report, algorithm": lambda name: read_run(run(algorithm=name)).changed_settings(),
    "ailsrs report, loss": lambda name: (
        read_run(run(settings={"discriminator_loss": name, "reward": name})).title
    ),
    "ailsrs report, source": lambda name: (
        read_run(run(source={"kind": "file", "name": name, "num_left_out": 0})).source
    ),
    "ailsrs report SWEEP": lambda name: show.report(sweep_results(name)),
    "demonstrations": lambda name: ail.train("swimmer", demonstrations(name), num_iterations=1),
    "sweep, environment": lambda name: spec(f'env = "{name}"\nalgorithm = "ars"'),
    "sweep, algorithm": lambda name: spec(f'env = "swimmer"\nalgorithm = ["ars", "{name}"]'),
    "sweep, loss": lambda name: spec(
        f'env = "swimmer"\nsettings.discriminator_loss = "{name}"\nnum_trajectories = 1'
    ),
    "sweep.json": saved_sweep,
}


@pytest.fixture
def trap(in_tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The file of the trace that some modules leave when they are imported."""
    trace = in_tmp_path / "trace"
    for module in ("evil", "evil/sub", "theirs/evil", "runs/theirs/evil"):
        path = in_tmp_path / (f"{module}/__init__.py" if module == "evil" else f"{module}.py")
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(EVIL.format(trace=str(trace)))

    monkeypatch.syspath_prepend(in_tmp_path)
    monkeypatch.setattr(sweep_page, "_figures", lambda *_: [])  # they take time
    return trace


@pytest.mark.parametrize(("reader", "name"), [*itertools.product(READERS, NAMES)])
def test_no_name_in_a_file_is_imported(
    reader: str, name: str, trap: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def import_module(module: str) -> None:
        trap.write_text(f"{module} was imported")

    monkeypatch.setattr(own_code, "importlib", SimpleNamespace(import_module=import_module))
    with contextlib.suppress(ail.UserError):
        READERS[reader](name)
    assert not trap.exists(), trap.read_text()
    assert not [x for x in sys.modules if "evil" in x or "f2py.__main__" in x]


def test_the_report_of_a_sweep_is_read_to_its_end(trap: Path) -> None:
    """Otherwise the names in its tables would not have been looked at."""
    show.report(sweep_results("theirs.evil:Task"))
    assert "theirs.evil:Task" in Path("theirs_sweep/report.html").read_text()
    assert not trap.exists()


@pytest.mark.parametrize(
    "reader", ["evaluate a policy", "ailsrs render", "ailsrs export", "demonstrate", "sweep, loss"]
)
def test_the_user_may_allow_a_name(reader: str, trap: Path) -> None:
    """This also shows that the trap works."""
    own_code.allow("theirs.evil:Task")
    with pytest.raises(SystemExit):
        READERS[reader]("theirs.evil:Task")
    assert trap.read_text() == "ran"
