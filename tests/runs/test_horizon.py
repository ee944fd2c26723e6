"""The number of steps of an episode is the same wherever a run is measured or shown."""

import json
import logging
from pathlib import Path

import numpy as np
import pytest

import ailsrs_jax as ail
from ailsrs_jax.data.demonstrations import Demonstrations, save_demonstrations
from ailsrs_jax.data.policies import load_policy
from ailsrs_jax.runs.horizon import LONGEST
from ailsrs_jax.runs.plan import plan
from ailsrs_jax.runs.spec import RunSpec
from ailsrs_jax.runs.storage.saved_run import read_run
from ailsrs_jax.show.curves import draw_curves
from ailsrs_jax.show.episodes.replay import replay
from ailsrs_jax.show.learning import _named_policies
from ailsrs_jax.show.reports.run_page import run_page
from tests.cli.test_cli import ailsrs, few_episodes  # noqa: F401
from tests.point_mass import EPISODE_LENGTH, PointMass


def swimmer_demonstrations(time_limit: int) -> Demonstrations:
    expert = ail.load_expert("swimmer")
    return ail.demonstrate(expert, 2, physics="mujoco", episode_length=time_limit)


def test_the_demonstrations_say_how_long_episodes_are(point_mass_expert: Demonstrations) -> None:
    spec = RunSpec(PointMass(), point_mass_expert, num_trajectories=2)
    assert plan(spec).config.settings.episode_length == EPISODE_LENGTH
    spec = RunSpec(PointMass(), point_mass_expert, subsample=7)
    assert plan(spec).config.settings.episode_length == EPISODE_LENGTH
    spec = RunSpec(PointMass(), point_mass_expert, settings={"episode_length": 30})
    made = plan(spec)
    assert (made.config.settings.episode_length, made.data.time_limit) == (30, 60)
    assert plan(RunSpec(PointMass(), algorithm="ars")).config.settings.episode_length == 1000


def test_the_command_makes_the_same_run_again(in_tmp_path: Path) -> None:
    """Also if the setting is the preset's, 1000, and the demonstrations have another."""
    save_demonstrations(swimmer_demonstrations(30), "short.npz")
    short = plan(RunSpec("swimmer", "short.npz", physics="mujoco"))
    assert short.config.settings.episode_length == 30
    assert "episode_length" not in str(short.spec.command)
    spec = RunSpec("swimmer", "short.npz", physics="mujoco", settings={"episode_length": 1000})
    assert "--set episode_length=1000" in str(plan(spec).spec.command)


def test_an_evaluation_over_another_number_of_steps_is_named(
    in_tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    short = {"num_iterations": 1, "gradient_steps": 1, "num_evaluation_episodes": 1}
    run = ail.train("swimmer", swimmer_demonstrations(30), algorithm="bc", seeds=[4, 5], **short)
    policy = run.policies[5]
    with caplog.at_level(logging.WARNING):
        ail.evaluate(policy, 1, "mujoco", episode_length=30)
        assert not caplog.messages
        ail.evaluate(policy, 1, "mujoco", episode_length=40)
    (line,) = caplog.messages
    assert "over 40 steps" in line
    assert "trained over 30" in line
    caplog.clear()
    policy.save("policy.npz")
    loaded = load_policy("policy.npz")  # a file does not say
    assert loaded.episode_length is None
    np.testing.assert_array_equal(loaded(np.ones(8)), policy(np.ones(8)))
    ail.evaluate(loaded, 1, "mujoco", episode_length=40)
    assert not caplog.messages


@pytest.mark.usefixtures("few_episodes")
@pytest.mark.parametrize("time_limit", [30, pytest.param(1500, marks=pytest.mark.slow)])
def test_everything_measures_with_the_horizon_of_the_run(
    time_limit: int, in_tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys
) -> None:
    recorded = swimmer_demonstrations(time_limit)
    save_demonstrations(recorded, "swimmer.npz")
    settings = ("--set", "gradient_steps=1", "num_evaluation_episodes=1")
    train = ("train", "swimmer", "--demonstrations", "swimmer.npz", "--algorithm", "bc")
    options = ("--iterations", "1", *settings, "--physics", "mujoco", "--output", "run", "--json")
    assert ailsrs(monkeypatch, *train, *options) == 0
    table = json.loads(capsys.readouterr().out)
    assert table["seeds"][0]["length_mean"] == time_limit
    assert table["episode_length"] == table["expert_episode_length"] == time_limit

    def lengths(*words: str) -> list[float]:
        assert ailsrs(monkeypatch, *words, "--json") == 0
        result = json.loads(capsys.readouterr().out)
        return [row["length_mean"] for row in result.get("policies", [result])]

    for policy in ("run", "run/seed_0/policy.npz", "run/seed_0/iterations/0.npz"):
        assert lengths("evaluate", policy, "--episodes", "2") == [time_limit]
    assert lengths("evaluate", "run", "--episodes", "2", "--episode-length", "7") == [7]
    demonstrate = ("demonstrate", "swimmer", "--expert", "run/seed_0/policy.npz")
    assert lengths(*demonstrate, "--num-trajectories", "1", "--output", "d.npz") == [time_limit]
    evaluation = ail.export("run", "out", num_episodes=1)
    assert evaluation is not None
    assert evaluation.lengths.tolist() == [time_limit]
    assert f"at most {time_limit} steps" in Path("out/README.md").read_text()
    page = run_page(read_run(Path("run")), episodes=1, video=False)
    assert page.parts[0].rows[0][5] == str(time_limit)
    assert page.tiles[0].value.endswith(" % of the expert")
    policy = ail.load_policy("run/seed_0/policy.npz")
    assert replay(policy, physics="mujoco", episode_length=time_limit).num_steps == time_limit
    animation = ail.render("run", "video.html", physics="mujoco", seconds=1e6)
    assert [each.num_steps for each in animation.replays] == [time_limit] * 2


@pytest.mark.usefixtures("few_episodes")
def test_returns_of_other_horizons_are_not_compared(
    in_tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys
) -> None:
    save_demonstrations(swimmer_demonstrations(30), "swimmer.npz")
    settings = ("--set", "gradient_steps=1", "num_evaluation_episodes=1", "episode_length=20")
    train = ("train", "swimmer", "--demonstrations", "swimmer.npz", "--algorithm", "bc")
    options = ("--iterations", "1", *settings, "--physics", "mujoco", "--output", "run")
    assert ailsrs(monkeypatch, *train, *options) == 0
    said = capsys.readouterr().out
    assert "in episodes of 30 steps, not 20" in " ".join(said.split())
    assert "%" not in said  # of the expert's return
    run = read_run(Path("run"))
    (name,) = _named_policies(run, Path("run/seed_0"))
    assert "of the expert" not in name
    _, labels = draw_curves(run).axes[0].get_legend_handles_labels()
    assert labels == ["seed 0"]
    page = run_page(run, episodes=1, video=False)
    assert page.tiles[0].value.startswith("return ")
    assert page.parts[0].rows[0][2] == "–"
    assert page.tiles[1].note.endswith("in episodes of 30 steps, not 20")


@pytest.mark.parametrize("length", [LONGEST + 1, 2 * 10**9, 0, -1, 1.5, True, "long"])
def test_a_horizon_in_a_file_has_bounds(length: object, in_tmp_path: Path) -> None:
    Path("run/seed_0").mkdir(parents=True)
    ail.load_expert("swimmer").save("run/seed_0/policy.npz")
    config = {"env_id": "Swimmer-v5", "settings": {"episode_length": length}}
    Path("run/config.json").write_text(json.dumps(config))
    with pytest.raises(ail.UserError, match=r"episode_length is .*, not from 1 to 10000"):
        ail.render("run", "video.html")


def test_the_limit_of_the_environment(in_tmp_path: Path) -> None:
    made = plan(RunSpec("gymnasium:Pendulum-v1", algorithm="ars", workers=1))
    assert made.config.settings.episode_length == 200
