"""The page on which policies run in the browser."""

import base64
import hashlib
import io
import json
import re
import subprocess
import tarfile
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest

import ailsrs_jax as ail
from ailsrs_jax.cli import show
from ailsrs_jax.show.episodes import play, wasm
from ailsrs_jax.show.learning import write_play
from tests.show.browser import BROWSER, ask_in_browser
from tests.show.reports.test_report import HOSTILE, Reader, write_run

needs_browser = pytest.mark.skipif(BROWSER is None, reason="no chromium: apt-get install chromium")
READY = "while (!globalThis.play) await new Promise((done) => setTimeout(done, 50));"


@pytest.fixture(scope="session")
def build() -> wasm.Build:
    try:
        return wasm.mujoco_build()
    except ail.UserError as error:
        pytest.skip(str(error))


@pytest.fixture
def no_build(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(play, "mujoco_build", lambda: wasm.Build("export default 0;", b"program"))


def random_policy(env_id: str) -> ail.SavedLinearPolicy:
    expert = ail.load_expert(env_id)
    p, n = len(expert.action_low), len(expert.mean)
    return ail.SavedLinearPolicy(
        weights=np.random.default_rng(0).normal(0, 0.3, (p, n)).astype(np.float32),
        mean=expert.mean,
        std=expert.std,
        action_low=expert.action_low,
        action_high=expert.action_high,
        env_id=env_id,
    )


def scene_of(page: str) -> dict[str, Any]:
    found = re.search('id="scene">(.*?)</script>', page)
    assert found is not None
    scene: dict[str, Any] = json.loads(found[1])
    return scene


def in_gymnasium(
    policy: ail.SavedPolicy, start: dict[str, list[float]], num_steps: int
) -> tuple[list[list[float]], float]:
    """Positions after each of at most ``num_steps`` steps, and the return."""
    env: Any = gymnasium.make(policy.env_id).unwrapped
    env.reset()
    env.set_state(np.array(start["qpos"]), np.array(start["qvel"]))
    positions, total, is_over = [], 0.0, False
    while len(positions) < num_steps and not is_over:
        _, reward, is_over, *_ = env.step(policy(env._get_obs()))
        positions.append(env.data.qpos.tolist())
        total += float(reward)
    return positions, total


@needs_browser
@pytest.mark.parametrize(
    "env_id",
    ["Ant-v5", "Hopper-v5", "Swimmer-v5"]
    + [pytest.param(name, marks=pytest.mark.slow) for name in ("HalfCheetah-v5", "Walker2d-v5")],
)
def test_the_browser_runs_gymnasiums_episode(
    env_id: str, build: wasm.Build, tmp_path: Path
) -> None:
    """The same positions and return, of a network and of a linear policy that sees everything."""
    policies = {"expert": ail.load_expert(env_id), "linear": random_policy(env_id)}
    page = play.play_html(policies, title="a title", seed=3)
    script = """
    play.setPause(true);
    return play.scene.policies.map((_, index) => {
      play.choose(index);
      play.begin(2);
      const positions = [];
      while (positions.length < 30 && !play.episode().over) {
        play.step();
        positions.push([...play.data.qpos]);
      }
      return [positions, play.episode().return];
    });"""
    episodes, console, asked = ask_in_browser(page, READY + script, tmp_path)
    assert (console, asked) == ([], [])
    start = scene_of(page)["starts"][2]
    for policy, (positions, total) in zip(policies.values(), episodes):
        expected, expected_total = in_gymnasium(policy, start, 30)
        np.testing.assert_allclose(positions, expected, rtol=0, atol=1e-6)
        assert total == pytest.approx(expected_total, abs=1e-4)


@needs_browser
def test_the_page_answers_its_reader(build: wasm.Build, tmp_path: Path) -> None:
    policies = {HOSTILE: random_policy("Hopper-v5"), "expert": ail.load_expert("hopper")}
    page = play.play_html(policies, title=HOSTILE)
    script = """
    const { model, data, scene, episode } = play, $ = (id) => document.getElementById(id);
    const set = (id, value) => {
      $(id).value = value;
      $(id).dispatchEvent(new Event("input"));
    };
    const frames = async (isDone) => {
      while (!isDone()) await new Promise(requestAnimationFrame);
    };
    const speedAfter = (prepare) => {
      play.begin(0);
      prepare();
      for (let i = 0; i < 5; i++) play.step();
      return [data.qvel[0], data.qvel[1]];
    };
    const pointer = (type, by) => {
      const box = $("canvas").getBoundingClientRect();
      const at = { clientX: box.left + box.width / 2 + by, clientY: box.top + 150, pointerId: 1 };
      $("canvas").dispatchEvent(new PointerEvent(type, at));
    };
    $("canvas").setPointerCapture = () => {};  // there is no real pointer
    const answer = {}, none = () => {};
    play.setPause(true);
    answer.chosen = $("policy").selectedOptions[0].textContent;
    answer.alone = speedAfter(none);
    answer.pushed = speedAfter(() => $("right").click());
    answer.pulled = speedAfter(() => {
      pointer("pointerdown", 0);
      pointer("pointermove", 300);
    });
    answer.freed = speedAfter(() => {
      pointer("pointerdown", 0);
      pointer("pointerup", 300);
    });
    set("gravity", 0);
    set("friction", 0.5);
    answer.floating = speedAfter(none);
    answer.friction = model.geom_friction[0];
    $("restore").click();
    answer.restored = [...speedAfter(none), model.opt.gravity[2], model.geom_friction[0]];

    const cell = document.querySelector('[data-at="1 4"]');
    cell.click();
    set("weight", 0.25);
    answer.cell = [cell.textContent, $("weight-name").textContent];
    answer.edited = speedAfter(none);
    $("restore-weights").click();
    answer.unedited = speedAfter(none);

    play.begin(0);
    while (!episode().over) play.step();
    answer.over = [episode().over, episode().steps];
    play.setPause(false);
    await frames(() => !episode().over);
    answer.next = episode().start;
    play.choose(1);
    await frames(() => episode().steps > 2);
    answer.hidden = [$("editor").hidden, $("viscosity").parentElement.hidden];
    answer.state = $("state").textContent;
    return answer;"""
    answer, console, asked = ask_in_browser(page, READY + script, tmp_path)
    assert (console, asked) == ([], [])
    assert answer["chosen"] == HOSTILE
    alone, pushed, pulled = (answer[name][0] for name in ("alone", "pushed", "pulled"))
    assert pushed > alone + 0.1
    assert pulled > alone + 0.1
    assert answer["freed"] == answer["alone"]
    assert answer["floating"][1] > answer["alone"][1] + 0.1
    assert answer["restored"] == [*answer["alone"], -9.81, 2 * answer["friction"]]
    assert answer["cell"] == ["0.25", "foot_joint → leg_joint"]
    assert answer["edited"] != answer["alone"] == answer["unedited"]
    fallen = len(in_gymnasium(random_policy("Hopper-v5"), scene_of(page)["starts"][0], 1000)[0])
    assert answer["over"] == ["fallen", fallen]
    assert answer["next"] == 1
    assert answer["hidden"] == [True, True]
    assert answer["state"] == "running"


@pytest.mark.usefixtures("no_build")
def test_the_policies_of_a_run(tmp_path: Path) -> None:
    settings = {"behavior_cloning_start": True, "episode_length": 70}
    run = write_run(tmp_path / "run", env_id="Swimmer-v5", settings=settings)
    (run / "result.json").write_text(
        (run / "result.json").read_text().replace('"mean": -20.0', '"mean": 20.0')
    )
    for name in ("policy", "iterations/0", "iterations/2"):
        random_policy("Swimmer-v5").save(run / "seed_0" / f"{name}.npz")
    shown = {
        "kept policy: -50 % of the expert": None,
        "clone of the expert: -150 % of the expert": None,
        "expert": None,
    }
    assert write_play(run, tmp_path / "play.html") == list(shown)
    page = (tmp_path / "play.html").read_text()
    scene = scene_of(page)
    assert [policy["name"] for policy in scene["policies"]] == list(shown)
    assert scene["episode_length"] == 70
    assert scene["starts"][0]["qpos"] != scene["starts"][1]["qpos"]
    assert "default-src 'none'" in page

    alone = tmp_path / "policy.npz"
    random_policy("Swimmer-v5").save(alone)
    show.render(alone, tmp_path / "alone.html", play=True, alone=True)
    (policy,) = scene_of((tmp_path / "alone.html").read_text())["policies"]
    assert policy["name"] == "policy"
    random_policy("Hopper-v5").save(run / "seed_0" / "iterations" / "0.npz")
    with pytest.raises(ail.UserError, match=r"0.npz is of Hopper-v5, not of the run's task"):
        write_play(run, tmp_path / "play.html")


@pytest.mark.usefixtures("no_build")
def test_names_stay_text(tmp_path: Path) -> None:
    page = play.play_html({HOSTILE: random_policy("Swimmer-v5")}, title=HOSTILE)
    (tmp_path / "play.html").write_text(page)
    assert scene_of(page)["policies"][0]["name"] == HOSTILE
    tags = [tag for tag, _ in Reader(tmp_path / "play.html").tags]
    assert tags.count("script") == 3
    assert "img" not in tags


def test_what_cannot_be_played_is_one_line(tmp_path: Path) -> None:
    random_policy("Swimmer-v5").save(tmp_path / "swimmer.npz")
    with pytest.raises(ail.UserError, match=r"name ends in \.html"):
        write_play(tmp_path / "swimmer.npz", tmp_path / "play.mp4")
    with pytest.raises(ail.UserError, match="cannot play Humanoid-v5: it knows Ant-v5, "):
        play.require_playable("Humanoid-v5")
    both = {"a": random_policy("Swimmer-v5"), "b": random_policy("Hopper-v5")}
    with pytest.raises(ail.UserError, match="of several tasks: Hopper-v5, Swimmer-v5"):
        play.play_html(both, title="")


@pytest.mark.parametrize("trouble", ["no npm", "no network", "too slow", "another file"])
def test_a_build_that_cannot_be_fetched_is_one_line(
    trouble: str, in_tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def npm(command: list[str], **options: Any) -> subprocess.CompletedProcess[str]:
        if trouble == "too slow":
            raise subprocess.TimeoutExpired(command, 1)
        if trouble == "another file":
            Path(options["cwd"], wasm.ARCHIVE).write_bytes(b"something else")
        return subprocess.CompletedProcess(command, 1, "", "npm error code ENOTFOUND\nmore")

    monkeypatch.setattr(subprocess, "run", npm)
    found = None if trouble == "no npm" else "/usr/bin/npm"
    monkeypatch.setattr(wasm.shutil, "which", lambda _: found)
    said = {
        "no npm": "install npm",
        "no network": r"\(npm error code ENOTFOUND\): the first page needs the internet",
        "too slow": "more than 300 s",
        "another file": "another @mujoco/mujoco@3.14.0 than was published",
    }
    with pytest.raises(ail.UserError, match=said[trouble]):
        wasm.mujoco_build()


def test_the_build_is_fetched_once(in_tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """And a damaged file in the cache is fetched again."""
    packed = io.BytesIO()
    with tarfile.open(fileobj=packed, mode="w:gz") as files:
        for name, content in {"mujoco.js": b"script", "mujoco.wasm": b"program"}.items():
            info = tarfile.TarInfo(f"package/{name}")
            info.size = len(content)
            files.addfile(info, io.BytesIO(content))
    archive = packed.getvalue()
    digest = base64.b64encode(hashlib.sha512(archive).digest()).decode()
    monkeypatch.setattr(wasm, "SHA512", digest)
    fetched = []

    def fetch() -> bytes:
        fetched.append(1)
        return archive

    monkeypatch.setattr(wasm, "_fetch", fetch)
    assert wasm.mujoco_build() == wasm.mujoco_build() == ("script", b"program")
    assert len(fetched) == 1
    (wasm.cache_directory() / wasm.ARCHIVE).write_bytes(archive[:-1])
    assert wasm.mujoco_build() == ("script", b"program")
    assert len(fetched) == 2
