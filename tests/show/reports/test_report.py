"""What ``ailsrs report`` writes: one page that loads nothing, whatever the files say."""

import base64
import dataclasses
import hashlib
import json
import shutil
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import ailsrs_jax as ail
from ailsrs_jax.data.sources import Source
from ailsrs_jax.own_code import allow
from ailsrs_jax.runs.evaluation import Evaluation
from ailsrs_jax.runs.inspection.run import SeedInspection
from ailsrs_jax.runs.storage.config import RunConfig
from ailsrs_jax.runs.storage.saved_run import read_run
from ailsrs_jax.show.episodes import renderer as offscreen
from ailsrs_jax.show.reports import page, run_page
from ailsrs_jax.trainers.algorithms import preset_settings
from tests.point_mass import EXPERT_WEIGHTS, linear_policy
from tests.sweeps.synthetic_sweep import row, write_sweep

HOSTILE = "</title><script>alert(1)</script><img src=https://x.invalid/a onerror='alert(2)'>"
POINT_MASS = "tests.point_mass:PointMass"
METRICS = """\
iteration,seed,env_steps,evaluation_return,evaluation_length,expert_distance,policy_score,expert_score
0,0,1000000,-30,60,0.5,0.2,0.8
0,3,1100000,-40,60,0.9,0.3,0.7
1,0,2000000,-10,60,0.25,0.4,0.6
1,3,2200000,-20,60,nan,0.45,0.55
2,0,3000000,-12,60,0.3,0.5,0.5
2,3,3300000,-15,60,0.7,0.5,0.5
"""
SCRIPT = Path(page.__file__).with_name("page.js").read_text()


def write_run(directory: Path, **changes: Any) -> Path:
    """A run of a toy task with two seeds, one of which has a policy."""
    settings = dataclasses.replace(preset_settings(POINT_MASS, "tuned"), noise_std=0.05)
    config = RunConfig(
        env_id=POINT_MASS,
        physics="none",
        seeds=(0, 3),
        algorithm="ailsrs",
        preset="tuned",
        settings=settings,
        num_trajectories=8,
        source=Source("file", "mine.npz"),
        demonstrations_sha256="0" * 64,
        subsample=1,
    )
    fields = config.as_json() | changes
    directory.mkdir(parents=True)
    (directory / "config.json").write_text(json.dumps(fields))
    (directory / "metrics.csv").write_text(METRICS)
    command = f"ailsrs train {POINT_MASS} --demonstrations mine.npz --num-trajectories 8"
    result = {
        "command": f"{command} --seeds 0 3 --set noise_std=0.05",
        "expert_return": {"mean": -20.0, "std": 1.0},
        "seeds": {
            "0": {"kept_iteration": 1, "score": -0.25},
            "3": {"kept_iteration": 2, "score": -0.7},
        },
    }
    (directory / "result.json").write_text(json.dumps(result))
    allow(POINT_MASS)
    linear_policy(EXPERT_WEIGHTS, POINT_MASS).save(directory / "seed_0" / "policy.npz")
    return directory


class Reader(HTMLParser):
    """The tags of a page, with their attributes, and its text."""

    def __init__(self, page: Path) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.words: list[str] = []
        self.feed(page.read_text())
        self.text = " ".join(" ".join(self.words).split())

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))

    def handle_data(self, data: str) -> None:
        self.words.append(data)


def require_harmless(page: Reader) -> None:
    """Nothing is run, and nothing loaded that is not in the page."""
    assert not {"iframe", "object", "embed", "base", "form"} & {t for t, _ in page.tags}
    assert [attributes for tag, attributes in page.tags if tag == "script"] == [{}]
    assert SCRIPT in page.words
    for tag, attributes in page.tags:
        assert not [name for name in attributes if name.startswith("on")], tag
        for name in ("src", "href", "srcset", "poster", "data"):
            assert (attributes.get(name) or "data:").startswith("data:"), attributes
    policy = next(a["content"] for t, a in page.tags if a.get("http-equiv"))
    assert policy is not None
    allowed = base64.b64encode(hashlib.sha256(SCRIPT.encode()).digest()).decode()
    assert policy.startswith("default-src 'none'; ")
    assert policy.endswith(f"script-src 'sha256-{allowed}'")


def test_a_run(tmp_path: Path) -> None:
    path = ail.report(write_run(tmp_path / "run"), episodes=2)
    assert path == tmp_path / "run" / "report.html"
    page = Reader(path)
    require_harmless(page)
    evaluation = ail.evaluate(ail.load_policy(tmp_path / "run/seed_0/policy.npz"), 2, "auto")
    for expected in (
        f"AILSRS on {POINT_MASS}",
        "8 demonstrations mine.npz · preset tuned · physics none",
        f"kept policy return {evaluation.mean:.0f} 1 of 2 seeds close to the expert; 1 of 2 seeds "
        "in part like the expert, by the energy distance · one seed",
        "expert -20 return of the demonstrations",
        "environment steps 3.30 M",
        "iterations 3 of 84",
        # The smallest distance; of seed 3 the second is NaN, so it is the third.
        f"0 {evaluation} – close to the expert 3.00 M 1000 1 0.250",
        "3 – – in part like the expert 3.30 M – 2 0.700",
        "Seed 3: the distance still falls: more iterations may help.",
        f"ailsrs train {POINT_MASS} --demonstrations mine.npz --num-trajectories 8 --seeds 0 3 "
        "--set noise_std=0.05",
        "it is not simulated by MuJoCo, so there is no model to draw",
        "numpy " + np.__version__,
    ):
        assert expected in page.text
    changed = [a for t, a in page.tags if t == "div" and a.get("class") == "changed"]
    assert len(changed) == 1
    assert [t for t, _ in page.tags].count("svg") == 3  # return, distance, scores
    assert "policy of seed 0 action 0 entry 0 -0.40 entry 1 -0.60" in page.text


def test_the_answer_is_a_share_of_the_expert_and_a_verdict(tmp_path: Path) -> None:
    run = dataclasses.replace(read_run(write_run(tmp_path / "run")), expert_return=200.0)
    evaluations = {
        seed: Evaluation(np.full(2, value), np.full(2, 60)) for seed, value in ((0, 190), (3, 98))
    }
    answer, *_ = run_page._tiles(run, evaluations, {})
    assert answer.value == "72 % of the expert"
    assert answer.note == "mean of 2 seeds, from 49 % to 95 %"
    table = run_page._seed_table(run, evaluations, {}, 2, "")
    assert [row[2] for row in table.rows] == ["95 %", "49 %"]
    # Nothing was measured: the distance is still an answer.
    judged = {0: SeedInspection(0, 1, 0.25, "close to the expert", ())}
    assert run_page._tiles(run, {}, judged)[0].value == "close to the expert"


def test_the_best_and_the_worst_seed_are_shown(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = write_run(tmp_path / "run")
    best = ail.load_policy(run / "seed_0" / "policy.npz")
    still = dataclasses.replace(best, weights=np.zeros((1, 2)))
    still.save(run / "seed_3" / "policy.npz")
    shown: dict[str, Any] = {}
    monkeypatch.setattr(run_page, "play", lambda _, policies, *__: shown.update(policies))
    run_page.run_page(read_run(run), episodes=2)
    assert {label: policy.weights.tolist() for label, policy in shown.items()} == {
        "best: seed 0": best.weights.tolist(),
        "worst: seed 3": [[0, 0]],
    }


def test_names_from_files_are_only_text(tmp_path: Path) -> None:
    versions = {HOSTILE: HOSTILE}
    source = {"kind": "file", "name": HOSTILE, "num_left_out": 0}
    changes = {"source": source, "preset": HOSTILE, "versions": versions}
    run = write_run(tmp_path / "run", **changes, settings={HOSTILE: HOSTILE})
    page = Reader(ail.report(run, tmp_path / "page.html", episodes=1, video=False))
    require_harmless(page)
    assert page.text.count(HOSTILE) >= 5


def test_nothing_is_simulated_because_a_file_says_how_much(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The expert's return is in ``result.json``, however many demonstrations it is of."""
    source = {"kind": "expert", "name": None, "num_left_out": 0}
    run = write_run(tmp_path / "run", env_id="Hopper-v5", source=source, num_trajectories=100_000)
    shutil.rmtree(run / "seed_0")
    monkeypatch.setattr("ailsrs_jax.runs.demonstrate.roll_out", None)
    page = Reader(ail.report(run))
    assert "100000 demonstrations of the expert that ships" in page.text
    assert "expert -20 return of the demonstrations" in page.text


def test_a_sweep(tmp_path: Path) -> None:
    rows = [
        row(0.9 + 0.02 * seed, label=label, env_id=env_id, seed=seed)
        for label in ("AILSRS", f"{HOSTILE} $\\frac$")
        for env_id in ("Hopper-v5", "Swimmer-v5")
        for seed in (0, 1)
    ]
    rows[0] |= {"cell": "../../outside", "status": f"failed: {HOSTILE}"}
    write_sweep(tmp_path / "sweep", rows)
    page = Reader(ail.report(tmp_path / "sweep"))
    require_harmless(page)
    for expected in (
        "sweep sweep 7 of 8 runs finished · 2 tasks · 1 to 2 seeds each · 8.40 M live steps",
        f"../../outside failed: {HOSTILE}",
        "Interquartile means over 2 conditions",
        "There are no runs beside these tables",
    ):
        assert expected in page.text
    images = [a["src"] or "" for t, a in page.tags if t == "img"]
    assert len(images) == 2  # scores, profiles
    # The table and a plot for each task come first; a series has one colour in all of them.
    titles = page.text.index("Interquartile means"), page.text.index("Training")
    assert titles[0] < titles[1] < page.text.index("Hopper-v5 demonstrations")
    colors = {a["data-name"]: a["style"] for t, a in page.tags if t == "g"}
    assert colors == {"AILSRS": "--color: #0072B2", f"{HOSTILE} $\\frac$": "--color: #D55E00"}
    for image in images:
        assert base64.b64decode(image.removeprefix("data:image/png;base64,")).startswith(b"\x89PNG")


def test_a_sweep_shows_its_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where there is no renderer it says so in the video's place, and how to get one."""
    monkeypatch.setenv("MUJOCO_GL", "disabled")
    offscreen.require_renderer.cache_clear()
    rows = [row(0.9, env_id="Hopper-v5", cell="here"), row(0.9, env_id="Swimmer-v5")]
    write_sweep(tmp_path, [each | {"random_return": 0.0} for each in rows])
    write_run(tmp_path / "cells" / "here")
    page = Reader(ail.report(tmp_path))
    assert "no video: MUJOCO_GL=disabled fails here; on Debian or Ubuntu: apt-get" in page.text
    assert f"ailsrs train {POINT_MASS}" in page.text
    assert "Discriminator's scores" in page.text


@pytest.mark.parametrize(
    ("changes", "problem"),
    [
        ({"seeds": []}, "seeds are"),
        ({"seeds": [0, True]}, "seeds are"),
        ({"seeds": [0, 4]}, "is not of the run with the seeds"),
        ({"seeds": [0, -3]}, "seed is -3"),
        ({"algorithm": "none"}, "unknown algorithm 'none'"),
        ({"algorithm": "bc"}, "has no column validation_loss"),
        ({"settings": None}, "settings is None"),
        ({"settings": {"a": [1]}}, "'a' is [1], not a value"),
        ({"num_trajectories": 2**31}, "num_trajectories is 2147483648"),
        ({"num_trajectories": 0}, "num_trajectories is 0"),
        ({"subsample": 10**4000}, "subsample is 1000"),
        ({"env_id": "a\nb"}, "env_id is not the name"),
    ],
)
def test_a_damaged_run_is_one_line(changes: dict[str, Any], problem: str, tmp_path: Path) -> None:
    run = write_run(tmp_path / "run", **changes)
    with pytest.raises(ail.UserError) as caught:
        ail.report(run)
    assert problem in str(caught.value)
    assert not (run / "report.html").exists()


def test_a_run_that_lacks_rows_is_refused(tmp_path: Path) -> None:
    """The row of an iteration is found by its number, as the kept one's is."""
    run = write_run(tmp_path / "run")
    header, first, *others = (run / "metrics.csv").read_text().splitlines(keepends=True)
    assert first.startswith("0,")
    assert others
    (run / "metrics.csv").write_text("".join([header, *others]))
    with pytest.raises(ail.UserError, match="lacks rows of seed 0"):
        ail.report(run)


def test_mistakes(tmp_path: Path) -> None:
    run = write_run(tmp_path / "run")
    with pytest.raises(ail.UserError, match="is neither a run nor a sweep"):
        ail.report(tmp_path)
    with pytest.raises(ail.UserError, match="cannot write"):
        ail.report(run, run / "config.json" / "page.html")
    (run / "report.html").symlink_to(run / "config.json")
    with pytest.raises(ail.UserError, match=r"report.html is a link: choose an --output"):
        ail.report(run)
    (run / "report.html").unlink()
    (tmp_path / "sweep.json").write_text("{}")
    with pytest.raises(ail.UserError, match="no run of this sweep is finished yet"):
        ail.report(tmp_path)
    (run / "seed_3").mkdir()
    policy = ail.load_policy(run / "seed_0" / "policy.npz")
    dataclasses.replace(policy, env_id="Hopper-v5").save(run / "seed_3" / "policy.npz")
    with pytest.raises(ail.UserError, match="is of Hopper-v5, not of the run's task"):
        ail.report(run)
