"""Commands that do what they are asked to."""

import importlib.metadata
import json
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ailsrs_jax.cli.main import main
from ailsrs_jax.data.demonstrations import load_demonstrations
from ailsrs_jax.data.policies import SavedPolicy, expert_path, load_policy
from ailsrs_jax.data.sources import content_hash
from ailsrs_jax.runs.evaluation import evaluate
from ailsrs_jax.show.curves import plot_training_curve
from tests.point_mass import linear_policy

TINY = [
    "num_directions=2",
    "num_top_directions=1",
    "episode_length=10",
    "discriminator_batch_size=16",
    "memory_samples=16",
    "num_distance_samples=50",
]

pytestmark = pytest.mark.usefixtures("in_tmp_path")


def ailsrs(monkeypatch: pytest.MonkeyPatch, *arguments: object) -> int:
    """Run the command line in this process and return its exit code."""
    monkeypatch.setattr(sys, "argv", ["ailsrs", *map(str, arguments)])
    try:
        main()
    except SystemExit as stop:
        return int(stop.code or 0)
    return 0


@pytest.fixture
def few_episodes(monkeypatch: pytest.MonkeyPatch) -> None:
    """Policies that a command has trained are evaluated in 2 episodes, not 100."""

    def measure(policy: SavedPolicy, num_episodes: int = 2, *rest: Any, **options: Any) -> Any:
        return evaluate(policy, num_episodes, *rest, **options)

    monkeypatch.setattr("ailsrs_jax.runs.evaluation.evaluate", measure)


@pytest.mark.usefixtures("few_episodes")
def test_train_evaluate_and_resume(monkeypatch, capsys) -> None:
    arguments = ["swimmer", "--iterations", 2, "--seeds", 0, 3, "--output", "run", "--set", *TINY]
    assert ailsrs(monkeypatch, "train", *arguments) == 0
    printed = capsys.readouterr().out
    assert "Swimmer-v5 · 10 demonstrations of the expert that ships with the package" in printed
    assert "2/2" in printed
    assert re.search(r"expert +\d+ ± \d+", printed)
    assert re.search(r"seed 0 is (close to|in part like|not like) the expert", printed)
    assert "ailsrs render run --output" in printed
    assert sorted(path.name for path in Path("run").iterdir()) == [
        ".lock",
        "checkpoints",
        "config.json",
        "metrics.csv",
        "result.json",
        "seconds.csv",
        "seed_0",
        "seed_3",
        "training_curve.png",
    ]
    assert Path("run/training_curve.png").read_bytes().startswith(b"\x89PNG")

    # The real Gymnasium environment, driven by the exported policy in NumPy.
    assert ailsrs(monkeypatch, "evaluate", "run", "--episodes", 2, "--json") == 0
    rows = json.loads(capsys.readouterr().out)["policies"]
    assert [row["policy"] for row in rows] == ["run/seed_0/policy.npz", "run/seed_3/policy.npz"]
    kept = load_policy("run/seed_3/policy.npz")
    expected = evaluate(kept, 2, "gymnasium", episode_length=10)  # as in training
    assert rows[1]["return_mean"] == expected.mean
    assert rows[1]["physics"] == "gymnasium"

    assert ailsrs(monkeypatch, "inspect", "run", "hopper") == 2
    assert "leave the other options out" in capsys.readouterr().err
    assert ailsrs(monkeypatch, "inspect", "run") == 0
    assert re.match(r"seed 0: .* the expert at iteration \d", capsys.readouterr().out)

    assert ailsrs(monkeypatch, "train", *arguments) == 2
    assert "add --resume" in capsys.readouterr().err
    assert ailsrs(monkeypatch, "train", *arguments, "--resume", "--json") == 0
    printed = capsys.readouterr()
    result = json.loads(printed.out)
    assert [seed["policy"] for seed in result["seeds"]] == [row["policy"] for row in rows]
    recorded = json.loads(Path("run/result.json").read_text())["seeds"]
    for seed in result["seeds"]:
        assert seed["verdict"] == recorded[str(seed["seed"])]["verdict"]
        assert seed["distance"] == -recorded[str(seed["seed"])]["score"]
    assert result["algorithm"] == "ailsrs"
    assert "policies, metrics and training curve are in run" in printed.err


@pytest.mark.usefixtures("few_episodes")
def test_demonstrations_of_ones_own_expert(monkeypatch, capsys) -> None:
    settings = ["num_iterations=2", "num_directions=2", "num_top_directions=1"]
    arguments = ["--algorithm", "ars", "--set", *settings, "episode_length=10"]
    arguments += ["--output", "expert.npz", "--quiet", "--json"]
    assert ailsrs(monkeypatch, "expert", "swimmer", *arguments) == 0
    printed = capsys.readouterr()
    assert json.loads(printed.out)["env_id"] == "Swimmer-v5"
    assert not printed.err
    assert load_policy("expert.npz").env_id == "Swimmer-v5"
    arguments = ["--expert", "expert.npz", "--num-trajectories", 2, "--output", "own.npz"]
    assert ailsrs(monkeypatch, "demonstrate", "swimmer", *arguments) == 0
    assert "2 trajectories of Swimmer-v5, return" in capsys.readouterr().out
    demonstrations = load_demonstrations("own.npz")
    assert demonstrations.observations.shape == (2, 1000, 8)
    arguments = ["--expert", "expert.npz", "--num-trajectories", 2, "--output", "json.npz"]
    assert ailsrs(monkeypatch, "demonstrate", "swimmer", *arguments, "--json") == 0
    fields = json.loads(capsys.readouterr().out)
    assert fields["return_mean"] == float(demonstrations.returns.mean())
    arguments = ["--expert", "expert.npz", "--output", "other.npz"]
    assert ailsrs(monkeypatch, "demonstrate", "hopper", *arguments) == 2
    capsys.readouterr()

    clones = {"linear_clone_return": 1.0, "neural_clone_return": 2.0}  # they take long to make
    monkeypatch.setattr("ailsrs_jax.runs.inspection.demonstrations._clones", lambda *_: clones)
    assert ailsrs(monkeypatch, "inspect", "own.npz", "--num-trajectories", 1) == 0
    printed = capsys.readouterr().out
    assert re.search(r"transitions +1000\b", printed)
    assert "simulated steps differ by           0.0 %" in printed
    assert "train Swimmer-v5 --demonstrations own.npz --num-trajectories 1" in printed
    assert ailsrs(monkeypatch, "inspect", "own.npz", "hopper") == 2
    assert "are of Swimmer-v5, not of Hopper-v5" in capsys.readouterr().err
    assert ailsrs(monkeypatch, "inspect", "minari:swimmer/own-v0") == 2
    assert "name the environment" in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.usefixtures("few_episodes")
def test_through_minari_and_subsampled(monkeypatch, capsys) -> None:
    pytest.importorskip("minari")
    arguments = ["--num-trajectories", 2, "--output", "minari:swimmer/ours-v0"]
    assert ailsrs(monkeypatch, "demonstrate", "swimmer", *arguments) == 0
    assert capsys.readouterr().out.endswith("in minari:swimmer/ours-v0\n")
    assert ailsrs(monkeypatch, "demonstrate", "swimmer", *arguments) == 2
    assert "swimmer/ours-v0 exists" in capsys.readouterr().err

    small = [assignment.replace("length=10", "length=40") for assignment in TINY]
    arguments = ["--demonstrations", "minari:swimmer/ours-v0", "--subsample", 20]
    arguments += ["--iterations", 1, "--output", "run", "--set", *small]
    assert ailsrs(monkeypatch, "train", "swimmer", *arguments) == 0
    assert "2 demonstrations minari:swimmer/ours-v0" in capsys.readouterr().out
    config = json.loads(Path("run/config.json").read_text())
    assert config["subsample"] == 20
    assert ailsrs(monkeypatch, "train", "hopper", *arguments[:2]) == 2
    assert "is of Swimmer-v5, not of Hopper-v5" in capsys.readouterr().err

    # What a file of the same episodes holds is the same, and hashed as what is trained on.
    arguments = ["--num-trajectories", 2, "--output", "ours.npz"]
    assert ailsrs(monkeypatch, "demonstrate", "swimmer", *arguments) == 0
    subsampled = load_demonstrations("ours.npz").subsample(20)
    assert config["demonstrations_sha256"] == content_hash(subsampled)


def test_the_cache_of_demonstrations_is_used_and_done_without(monkeypatch, tmp_path) -> None:
    from ailsrs_jax.runs import demonstrate

    first = demonstrate.expert_demonstrations("Swimmer-v5", 2, "mujoco")
    (cached,) = (tmp_path / "cache").rglob("*.npz")
    written = cached.stat().st_mtime_ns
    again = demonstrate.expert_demonstrations("Swimmer-v5", 2, "mujoco")
    np.testing.assert_array_equal(first.observations, again.observations)
    assert cached.stat().st_mtime_ns == written
    cached.write_bytes(b"damaged")
    np.testing.assert_array_equal(
        demonstrate.expert_demonstrations("Swimmer-v5", 2, "mujoco").actions, first.actions
    )
    monkeypatch.setenv("XDG_CACHE_HOME", "/proc/no")
    np.testing.assert_array_equal(
        demonstrate.expert_demonstrations("Swimmer-v5", 2, "mujoco").actions, first.actions
    )


def test_fewer_demonstrations_are_the_first_of_more() -> None:
    from ailsrs_jax.runs.demonstrate import demonstrate

    expert = load_policy(expert_path("Swimmer-v5"))
    few, more = (demonstrate(expert, number, physics="mujoco") for number in (2, 3))
    np.testing.assert_array_equal(few.observations, more.observations[:2])


@pytest.mark.parametrize("physics", ["mujoco", "gymnasium"])
def test_a_policy_must_fit_where_it_is_evaluated(physics: str, monkeypatch, capsys) -> None:
    linear_policy(np.ones((2, 5)), "Swimmer-v5").save(Path("policy.npz"))
    assert ailsrs(monkeypatch, "evaluate", "policy.npz", "--physics", physics) == 2
    assert (
        "takes 5 observations and gives 2 actions: the environment has 8 and 2"
        in capsys.readouterr().err
    )


def test_our_task_and_gymnasium_agree_on_an_expert() -> None:
    expert = load_policy(expert_path("Swimmer-v5"))
    ours, theirs = (evaluate(expert, 10, physics) for physics in ("mujoco", "gymnasium"))
    assert ours.mean == pytest.approx(theirs.mean, abs=3.0)


def test_without_arguments_there_is_help_and_the_version_can_be_asked_for(
    monkeypatch, capsys
) -> None:
    assert ailsrs(monkeypatch) == 0
    assert "Example: ailsrs train hopper" in capsys.readouterr().out
    assert ailsrs(monkeypatch, "--version") == 0
    assert capsys.readouterr().out == f"ailsrs {importlib.metadata.version('ailsrs_jax')}\n"


def test_help_starts_no_backend_and_is_quick_to_import() -> None:
    program = (
        "import sys, ailsrs_jax, ailsrs_jax.cli.main; "
        "assert not {'jax', 'mujoco', 'brax'} & set(sys.modules), sorted(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", program], check=True)
    help_text = subprocess.run(
        [sys.executable, "-m", "ailsrs_jax", "train", "--help"],
        check=True,
        capture_output=True,
        text=True,
        env=os.environ | {"COLUMNS": "100"},
    ).stdout
    assert "ailsrs train hopper --num-trajectories 10" in help_text


def test_a_curve_needs_metrics(tmp_path: Path) -> None:
    from ailsrs_jax.errors import UserError

    with pytest.raises(UserError, match="no such file"):
        plot_training_curve(tmp_path)
