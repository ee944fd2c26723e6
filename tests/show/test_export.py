"""Exported policies, and their model cards."""

import dataclasses
import json
import re
import shlex
import sys
from pathlib import Path

import numpy as np
import pytest

import ailsrs_jax as ail
from ailsrs_jax.data.policies import expert_path, load_policy
from ailsrs_jax.data.sources import Source
from ailsrs_jax.runs.storage.config import RunConfig
from tests.cli.test_cli import ailsrs
from tests.point_mass import PointMass
from tests.runs.test_own_env import spring


def header(card: str) -> dict:
    """Return the metadata that the Hugging Face Hub reads."""
    yaml = pytest.importorskip("yaml")
    return yaml.safe_load(card.split("---\n")[1])


def run_blocks(card: str) -> dict:
    """Run the card's blocks of Python in order, and return the names that they define."""
    names: dict = {}
    for block in re.findall(r"```python\n(.*?)```", card, re.DOTALL):
        exec(block, names)
    return names


def make_run(policy: ail.SavedPolicy, **changes: object) -> dict:
    """Write a run directory with one policy, and return its changed configuration."""
    settings = ail.preset_settings("Swimmer-v5", "tuned")
    config = RunConfig(
        env_id="Swimmer-v5",
        physics="mjx",
        seeds=(0, 3),
        algorithm="ailsrs",
        preset="tuned",
        settings=dataclasses.replace(settings, noise_std=0.05),
        num_trajectories=4,
        source=Source("file", "/home/somebody/my demos.npz"),
        demonstrations_sha256="0" * 64,
        subsample=20,
    ).as_json()
    config |= changes
    policy.save("run/seed_3/policy.npz")
    Path("run/config.json").write_text(json.dumps(config))
    columns = "iteration,seed,env_steps,evaluation_return,expert_distance"
    Path("run/metrics.csv").write_text(f"{columns}\n0,3,10,1.0,2.0\n")
    command = "ailsrs train swimmer --demonstrations '/home/somebody/my demos.npz' --seeds 0 3"
    result = {"command": command, "expert_return": None, "seeds": {}}
    Path("run/result.json").write_text(json.dumps(result))
    return config


def linear_policy() -> ail.SavedPolicy:
    rng = np.random.default_rng(0)
    return ail.SavedLinearPolicy(
        weights=rng.normal(size=(2, 8)),
        mean=rng.normal(size=8),
        std=np.exp(rng.normal(size=8)),
        action_low=-np.ones(2),
        action_high=np.ones(2),
        env_id="Swimmer-v5",
    )


def exported(changes: dict[str, object]) -> str:
    """Export a run with a changed configuration, and return its card."""
    make_run(linear_policy(), **changes)
    ail.export("run", "out", num_episodes=1)
    return Path("out/README.md").read_text()


def test_a_run_is_published(in_tmp_path: Path, monkeypatch, capsys) -> None:
    pytest.importorskip("onnxruntime")
    policy = linear_policy()
    config = make_run(policy)
    arguments = ["run", "--output", "out", "--episodes", 2, "--license", "mit"]
    assert ailsrs(monkeypatch, "export", *arguments) == 0
    printed = capsys.readouterr().out
    names = ["README.md", "policy.h", "policy.npz", "policy.onnx", "policy.safetensors"]
    assert sorted(path.name for path in Path("out").iterdir()) == names

    card = Path("out/README.md").read_text()
    evaluation = ail.evaluate(policy, 2)
    assert printed == f"run is now in out, return {evaluation} over 2 episodes\n"
    for said in (
        "# AILSRS on Swimmer-v5",
        f"| return | {evaluation} over 2 episodes (in Gymnasium, at most 1000 steps, seed 0) |",
        "| algorithm | AILSRS, preset tuned |",
        "| seed | 3 |",
        f"| demonstrations | 4 of my demos.npz, one step in 20; SHA-256 {'0' * 64} |",
        "| policy | linear, 8 observations, 2 actions |",
        f"jax {config['versions']['jax']}",
    ):
        assert said in card
    head = header(card)
    assert (head["license"], head["library_name"]) == ("mit", "ailsrs_jax")
    assert head["tags"] == ["imitation-learning", "reinforcement-learning", "Swimmer-v5"]
    (model,) = head["model-index"]
    (result,) = model["results"]
    assert result["dataset"] == {"type": "Swimmer-v5", "name": "Swimmer-v5"}
    assert result["metrics"][0]["value"] == f"{evaluation.mean:.2f} +/- {evaluation.std:.2f}"

    # An export is evaluated like a run, and does not overwrite anything.
    assert ailsrs(monkeypatch, "evaluate", "out", "--episodes", 2, "--json") == 0
    (row,) = json.loads(capsys.readouterr().out)["policies"]
    assert row["return_mean"] == evaluation.mean
    assert ailsrs(monkeypatch, "export", "run", "--output", "out") == 2
    assert "out is not empty: choose another --output" in capsys.readouterr().err

    # With --json, the command prints the output and the return.
    assert ailsrs(monkeypatch, "export", "run", "--output", "other", *arguments[3:5], "--json") == 0
    told = json.loads(capsys.readouterr().out)
    assert (told["output"], told["return_mean"]) == ("other", evaluation.mean)
    assert ailsrs(monkeypatch, "export", "run", "--output", "policy.onnx", "--json") == 0
    assert json.loads(capsys.readouterr().out) == {"policy": "run", "output": "policy.onnx"}

    # The card's programs run, and give the policy's actions.
    monkeypatch.chdir("out")
    left = run_blocks(card)
    expected = policy(np.zeros(8))
    np.testing.assert_array_equal(left["action"], expected)
    np.testing.assert_allclose(left["actions"], expected[None], atol=1e-5)


def test_the_hub_reads_the_card(in_tmp_path: Path) -> None:
    hub = pytest.importorskip("huggingface_hub")
    make_run(linear_policy())
    ail.export("run", "out", num_episodes=1, license_id="apache-2.0")
    data = hub.ModelCard.load("out/README.md", ignore_metadata_errors=False).data
    assert (data.license, data.pipeline_tag) == ("apache-2.0", "reinforcement-learning")
    (result,) = data.eval_results
    assert (result.task_type, result.metric_type) == ("reinforcement-learning", "mean_reward")
    assert result.dataset_name == "Swimmer-v5"


@pytest.mark.slow
def test_the_command_makes_the_run_again(in_tmp_path: Path, monkeypatch) -> None:
    settings = ["episode_length=20", "num_distance_samples=50"]
    arguments = ["--algorithm", "bc", "--num-trajectories", 2, "--seeds", 3, "--iterations", 1]
    command = ["train", "swimmer", *arguments, "--output", "run", "--set", *settings]
    assert ailsrs(monkeypatch, *command) == 0
    ail.export("run", "out", num_episodes=1)
    (command,) = re.findall(r"```sh\n(.*)\n```", Path("out/README.md").read_text())
    program, *again = shlex.split(command)
    assert program == "ailsrs"
    assert ailsrs(monkeypatch, *again, "--output", "again") == 0
    assert Path("again/config.json").read_bytes() == Path("run/config.json").read_bytes()
    assert (
        Path("again/seed_3/policy.npz").read_bytes() == Path("run/seed_3/policy.npz").read_bytes()
    )


def test_the_command_does_not_name_the_folder(in_tmp_path: Path) -> None:
    card = exported({})
    assert "```sh\nailsrs train swimmer --demonstrations 'my demos.npz' --seeds 0 3\n" in card
    assert "/home" not in card


def test_an_algorithm_that_does_not_imitate(in_tmp_path: Path) -> None:
    reward = dict.fromkeys(("source", "demonstrations_sha256", "num_trajectories", "subsample"))
    card = exported({"algorithm": "ars", **reward})
    assert "imitation-learning" not in header(card)["tags"]
    assert "| demonstrations | none: it learnt from the environment's reward |" in card


def test_what_was_handed_in_from_python_has_no_command(in_tmp_path: Path) -> None:
    make_run(linear_policy(), source={"kind": "memory", "name": None, "num_left_out": 0})
    result = {"command": None, "expert_return": None, "seeds": {}}
    Path("run/result.json").write_text(json.dumps(result))
    ail.export("run", "out", num_episodes=1)
    card = Path("out/README.md").read_text()
    assert "were handed in from Python" in card
    assert "4 handed in from Python, one step in 20; SHA-256 0000" in card
    assert "```sh" not in card


def test_an_environment_of_ones_own(in_tmp_path: Path) -> None:
    make_run(spring(), env_id="PointMass", physics="none")
    ail.export("run", "out", num_episodes=1, env=PointMass())
    card = Path("out/README.md").read_text()
    assert re.search(r"\| return \| -\d+ ± 0 over 1 episodes \(in an environment handed in", card)


DAMAGED = {
    "seeds is '0'": {"seeds": "0"},
    "is not of the run with the seeds [0]": {"seeds": [0]},
    "run is a run of Hopper-v5 with the seeds": {"env_id": "Hopper-v5"},
    "not a value": {"settings": {"noise_std": [1]}},
    "unknown algorithm 'best'": {"algorithm": "best"},
}


@pytest.mark.parametrize(("message", "changes"), DAMAGED.items())
def test_a_damaged_configuration_is_refused(message: str, changes: dict, in_tmp_path: Path) -> None:
    with pytest.raises(ail.UserError) as caught:
        exported(changes)
    assert message in str(caught.value)
    assert not Path("out").exists()


@pytest.mark.parametrize("name", ["subsample", "source", "num_trajectories", "preset"])
def test_a_configuration_that_lacks_something_is_refused(name: str, in_tmp_path: Path) -> None:
    config = make_run(linear_policy())
    del config[name]
    Path("run/config.json").write_text(json.dumps(config))
    with pytest.raises(ail.UserError, match=f"{name} is missing"):
        ail.export("run", "out")


@pytest.mark.parametrize("name", ["subsample", "num_trajectories"])
def test_of_demonstrations_everything_is_known(name: str, in_tmp_path: Path) -> None:
    with pytest.raises(ail.UserError, match=f"{name} is missing"):
        exported({name: None})


def test_names_are_no_markup(in_tmp_path: Path) -> None:
    card = exported(
        {
            "source": {"kind": "file", "name": "a|`<b>*[x](y).npz", "num_left_out": 0},
            "versions": {"<i>": "|"},
        }
    )
    assert r"of a\|\`\<b\>\*[x\](y).npz, one step in 20" in card
    assert r"| versions | \<i\> \| |" in card


def test_a_policy_that_nobody_knows_of(in_tmp_path: Path, monkeypatch) -> None:
    ail.export(ail.load_expert("swimmer"), "out", num_episodes=1)
    card = Path("out/README.md").read_text()
    assert "# A policy on Swimmer-v5" in card
    assert "does not say how the policy was trained" in card
    assert header(card)["license"] == "unknown"
    assert header(card)["tags"] == ["reinforcement-learning", "Swimmer-v5"]
    pytest.importorskip("onnxruntime")
    monkeypatch.chdir("out")
    names = run_blocks(card)
    expected = load_policy(expert_path("Swimmer-v5"))(np.zeros(8))
    np.testing.assert_allclose(names["action"], expected, rtol=1e-12)


def test_mistakes_are_named_and_nothing_is_written(in_tmp_path: Path, monkeypatch) -> None:
    for seed in (0, 1):
        spring().save(f"run/seed_{seed}/policy.npz")
    Path("full").mkdir()
    Path("full/README.md").write_text("mine")
    expert = ail.load_expert("swimmer")
    before = sorted(Path().rglob("*"))
    calls = {
        "run holds 2 policies: choose one, for example run/seed_0/policy.npz": lambda: ail.export(
            "run", "policy.onnx"
        ),
        "policy.pt: the name of a policy's file ends in": lambda: ail.export(expert, "policy.pt"),
        "full is not empty": lambda: ail.export(expert, "full"),
        "names no licence": lambda: ail.export(expert, "out", license_id="a\nb: c"),
        "no such file": lambda: ail.export("missing.npz", "out"),
        "0 episodes": lambda: ail.export(expert, "out", num_episodes=0),
        "cannot write": lambda: ail.export(expert, "full/README.md/out"),
        "File name too long": lambda: ail.export(expert, f"{'x' * 300}.npz"),
        "unknown environment": lambda: ail.export(spring(), "out"),
        "seed is -1": lambda: ail.export(expert, "out", seed=-1),
    }
    for message, call in calls.items():
        with pytest.raises(ail.UserError) as caught:
            call()
        assert message in str(caught.value)
    for package in ("huggingface_hub", "onnx"):
        with monkeypatch.context() as patch:
            patch.setitem(sys.modules, package, None)  # not installed
            with pytest.raises(ail.UserError, match=r"pip install 'ailsrs_jax\[export\]'"):
                ail.export(expert, "out")
    assert sorted(Path().rglob("*")) == before


def test_a_strangers_file_is_converted_but_not_looked_up(in_tmp_path: Path) -> None:
    dataclasses.replace(spring(), env_id="os:abort").save("policy.npz")
    ail.export("policy.npz", "policy.safetensors")
    assert load_policy("policy.safetensors").env_id == "os:abort"
    with pytest.raises(ail.UserError, match="could do anything"):
        ail.export("policy.npz", "out", physics="auto")
