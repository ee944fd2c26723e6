"""What ``ailsrs render`` shows: episodes, pictures, files."""

import base64
import dataclasses
import io
import json
import re
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import av
import mujoco
import numpy as np
import pytest
from brax import envs
from PIL import Image

import ailsrs_jax as ail
from ailsrs_jax.data.policies import expert_path, load_policy
from ailsrs_jax.data.sources import Source
from ailsrs_jax.show.episodes import renderer as offscreen
from ailsrs_jax.show.episodes.frames import GAP, side_by_side
from ailsrs_jax.show.episodes.replay import Replay, replay
from ailsrs_jax.show.video import Animation, encode, shipped_expert
from tests.point_mass import PointMass, linear_policy

SLIDER = """
<mujoco>
  <worldbody>
    <geom name="floor" type="plane" size="0 0 1"/>
    <body name="cart" pos="0 0 0.5">
      <joint name="slide" type="slide" axis="1 0 0"/>
      <geom size="0.1" mass="1" rgba="1 0 0 1"/>
      <geom type="box" size="0.1 0.2 0.3" mass="0.1" group="3"/>
      <body pos="0 0 1"><geom type="capsule" size="0.1 0.2" mass="0.1"/></body>
    </body>
  </worldbody>
  <actuator><motor joint="slide" ctrlrange="-1 1"/></actuator>
</mujoco>
"""


class Slider(ail.MujocoTask):
    """One's own task: ends beyond 0.5."""

    def __init__(self, xml_file: str) -> None:
        flags = {"frame_skip": 5, "reset_noise_scale": 0.1, "num_hidden_positions": 0}
        super().__init__(physics="mujoco", xml_file=xml_file, **flags)

    def _reward_terms(self, before: Any, after: Any, action: Any) -> Any:
        return {"reward_right": after.qpos[0]}

    def _terminated(self, physics_state: Any) -> Any:
        return abs(physics_state.qpos[0]) > 0.5


def push(force: float) -> ail.SavedPolicy:
    """The same force whatever is observed, of at most 1."""
    limit = np.full(1, force)
    return linear_policy(np.zeros((1, 2)), "Slider", action_low=limit, action_high=limit)


@pytest.fixture(scope="module")
def slider(tmp_path_factory: pytest.TempPathFactory) -> Slider:
    path = tmp_path_factory.mktemp("model") / "slider.xml"
    path.write_text(SLIDER)
    return Slider(str(path))


def made_up(num_steps: int, dt: float = 0.05, *, ended: bool = False) -> Replay:
    model = mujoco.MjModel.from_xml_string(SLIDER)
    positions = np.linspace(0, 1, num_steps + 1)[:, None]
    rewards = np.ones(num_steps)
    return Replay(model=model, positions=positions, env_rewards=rewards, dt=dt, ended=ended)


def test_the_episode_is_the_first_that_is_evaluated() -> None:
    expert = load_policy(expert_path("Swimmer-v5"))
    shown = replay(expert, physics="mujoco", seconds=0.4)
    evaluated = ail.evaluate(expert, 2, "mujoco", episode_length=10)
    assert shown.num_steps == evaluated.lengths[0] == 10
    assert shown.env_rewards.sum() == pytest.approx(evaluated.returns[0], rel=1e-5)
    other = replay(expert, physics="mujoco", seed=1, seconds=0.04)
    assert not np.array_equal(shown.positions[0], other.positions[0])


def test_ones_own_task_ends_where_it_ends(slider: Slider) -> None:
    right, still = (replay(push(force), env=slider, seconds=2) for force in (1.0, 0.0))
    np.testing.assert_array_equal(right.positions[0], still.positions[0])
    assert right.ended
    assert not still.ended
    assert (abs(right.positions[:-1]) <= 0.5).all()
    assert right.positions[-1] > 0.5
    assert still.num_steps == 200
    # Newton: 1 N on 1 kg and the capsule's mass, through a frictionless slide.
    time = right.dt * np.arange(right.num_steps + 1)
    moved = right.positions[:, 0] - right.positions[0, 0]
    mass = slider.physics.model.body_mass.sum()
    velocity = (moved[1] - 0.5 * time[1] ** 2 / mass) / time[1]
    np.testing.assert_allclose(moved, velocity * time + 0.5 * time**2 / mass, atol=2e-3)


def test_beside_a_policy_is_the_expert_that_it_imitated() -> None:
    linear = shipped_expert("Hopper-v5", None, Source("expert", "linear"))
    assert isinstance(linear, ail.SavedLinearPolicy)
    for imitated in ((), (Source("file", "linear"),), (Source("expert"),)):
        assert isinstance(shipped_expert("Hopper-v5", *imitated), ail.SavedMlpPolicy)


def test_what_mujoco_does_not_simulate_is_refused() -> None:
    for env in (PointMass(), envs.get_environment("fast")):
        with pytest.raises(ail.UserError, match="it is not simulated by MuJoCo"):
            replay(push(0.0), env=env)


@pytest.mark.parametrize(
    ("dt", "stride", "fps"),
    [(0.008, 3, 125 / 3), (0.05, 1, 20), (0.04, 1, 25), (0.015, 2, 100 / 3), (1 / 60, 1, 60)],
)
def test_time_goes_as_fast_as_it_does(dt: float, stride: int, fps: float) -> None:
    animation = Animation([made_up(10, dt)], ["policy"])
    assert animation.stride == stride
    assert float(animation.fps) == pytest.approx(fps)


def test_panels_are_side_by_side_in_rows_of_four() -> None:
    panels = [np.full((2, 6, 8, 3), 50 * index, np.uint8) for index in range(5)]
    together = side_by_side(panels)
    assert together.shape == (2, 12 + GAP, 32 + 3 * GAP, 3)
    for index, panel in enumerate(panels):
        top, left = (index // 4) * (6 + GAP), (index % 4) * (8 + GAP)
        np.testing.assert_array_equal(together[:, top : top + 6, left : left + 8], panel)


def test_an_mp4_holds_the_frames() -> None:
    frames = np.zeros((12, 64, 96, 3), np.uint8)
    frames[:, :, :48] = np.linspace(0, 255, 12).astype(np.uint8)[:, None, None, None]
    animation = Animation([made_up(11, 0.008)], ["policy"])
    with av.open(io.BytesIO(encode(frames, animation.fps))) as container:
        stream = container.streams.video[0]
        assert stream.codec_context.name == "h264"
        assert stream.average_rate == animation.fps
        decoded = [frame.to_ndarray(format="rgb24") for frame in container.decode(stream)]
    np.testing.assert_allclose(np.stack(decoded).astype(int), frames, atol=20)


@pytest.mark.parametrize("asked", ["disabled", "nonsense"])
def test_without_a_renderer_one_line_says_what_to_install(
    asked: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("MUJOCO_GL", asked)
    offscreen.require_renderer.cache_clear()
    with pytest.raises(ail.UserError, match=f"MUJOCO_GL={asked} fails here; on Debian or Ubuntu: "):
        offscreen.require_renderer()


def test_mistakes(slider: Slider, tmp_path: Path) -> None:
    swimmer, hopper = (load_policy(expert_path(name)) for name in ("Swimmer-v5", "Hopper-v5"))
    calls: dict[str, Callable[[], object]] = {
        "the name must end in .mp4, .webp or .html": lambda: ail.render(
            swimmer, tmp_path / "a.gif"
        ),
        "the expert is of Hopper-v5, the policy of Swimmer-v5": lambda: ail.render(
            swimmer, tmp_path / "a.html", expert=hopper
        ),
        "size is 15": lambda: ail.render(swimmer, tmp_path / "a.html", size=15),
        "seconds is 0": lambda: ail.render(swimmer, tmp_path / "a.html", seconds=0),
        "takes 8 observations and gives 2 actions": lambda: ail.render(
            swimmer, tmp_path / "a.html", env=slider, alone=True
        ),
    }
    for message, call in calls.items():
        with pytest.raises(ail.UserError) as caught:
            call()
        assert message in str(caught.value)
    assert not list(tmp_path.iterdir())


def test_brax_viewer_is_given_the_poses(slider: Slider, tmp_path: Path) -> None:
    path = tmp_path / "slider.html"
    animation = ail.render(push(1.0), path, expert=push(-1.0), env=slider, seconds=2)
    packed = re.search(r'var system = "([^"]+)"', path.read_text())
    assert packed is not None
    scene = json.loads(zlib.decompress(base64.b64decode(packed[1])))
    assert scene["opt"]["timestep"] == pytest.approx(slider.dt)
    shapes = {name: [shape["name"] for shape in each] for name, each in scene["geoms"].items()}
    assert shapes == {  # one floor; the box is in a group that MuJoCo's viewer hides, too
        "world": ["Plane"],
        "expert_cart": ["Sphere"],
        "expert_2": ["Capsule"],
        "policy_cart": ["Sphere"],
        "policy_2": ["Capsule"],
    }
    assert scene["geoms"]["policy_cart"][0]["rgba"] == [1, 0, 0, 1]
    assert scene["geoms"]["world"][0]["link_idx"] == -1
    states = scene["states"]["x"]
    expert, policy = animation.replays
    assert len(states) == max(expert.num_steps, policy.num_steps) + 1
    for name, shown in {"expert_2": expert, "policy_2": policy}.items():
        link = scene["geoms"][name][0]["link_idx"]
        along = np.array([state["pos"][link] for state in states])
        assert np.ptp(along[:, 1]) == 0  # beside one another
        np.testing.assert_allclose(along[:, 2], 1.5)
        stays = shown.positions[np.minimum(np.arange(len(states)), shown.num_steps), 0]
        np.testing.assert_allclose(along[:, 0], stays, atol=1e-5)
    links = [scene["geoms"][f"{label}_cart"][0]["link_idx"] for label in ("expert", "policy")]
    # The policy is nearer to the camera, which follows the first body.
    beside, in_front = (states[0]["pos"][link][1] for link in links)
    assert beside > in_front + 0.5
    assert next(name for name in scene["geoms"] if name != "world") == "policy_cart"
    assert scene["labels"] == {"policy": "policy_cart", "expert": "expert_cart"}
    assert 1 < scene["size"] < 3


@pytest.mark.filterwarnings("ignore")  # of OpenGL's bindings
def test_expert_and_policy_are_drawn(slider: Slider, tmp_path: Path) -> None:
    """With whatever OpenGL library is here, found in a process that MuJoCo is imported in."""
    offscreen.require_renderer.cache_clear()
    try:
        offscreen.require_renderer()
    except ail.UserError as error:
        pytest.skip(str(error))
    seen: list[tuple[int, int]] = []
    animation = Animation(
        [made_up(4), made_up(2, ended=True)],
        ["expert", "policy"],
        64,
        watch=lambda done, total: seen.append((done, total)),
    )
    frames = animation.frames
    assert frames.shape == (5, 64 + 16, 128 + GAP, 3)
    assert seen == [(done, 10) for done in range(1, 11)]
    expert, policy = frames[:, 16:, :64], frames[:, 16:, 64 + GAP :]
    np.testing.assert_array_equal(expert[0], policy[0])  # the same pose
    assert (expert[1:] != expert[:-1]).any(axis=(1, 2, 3)).all()  # it moves
    red = (expert[..., 0].astype(int) - expert[..., 1]) > 60
    where = [np.argwhere(each)[:, 1].mean() for each in red]
    assert (np.diff(where) > 0).all()  # to the right
    np.testing.assert_array_equal(policy[3], policy[2] // 2)  # over: darker, and still
    np.testing.assert_array_equal(policy[3], policy[4])

    animation.save(tmp_path / "slider.mp4")
    source = re.search(r'src="data:video/mp4;base64,([^"]+)"', animation._repr_html_())
    assert source is not None
    assert base64.b64decode(source[1]) == (tmp_path / "slider.mp4").read_bytes()
    with av.open(tmp_path / "slider.mp4") as container:
        assert sum(1 for _ in container.decode(video=0)) == 5
    animation.save(tmp_path / "slider.webp")
    with Image.open(tmp_path / "slider.webp") as picture:
        assert (picture.format, picture.size) == ("WEBP", (128 + GAP, 64 + 16))
        assert picture.n_frames == 5


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:Brax System", "ignore:Accessing `")
def test_brax_environments_can_be_shown() -> None:
    still = dataclasses.replace(
        push(0.0), weights=np.zeros((1, 4)), mean=np.zeros(4), std=np.ones(4)
    )
    shown = [
        replay(still, env=envs.get_environment("inverted_pendulum", backend=name), seconds=0.2)
        for name in ("generalized", "mjx")
    ]
    for each in shown:
        assert each.positions.shape == (6, each.model.nq)
        assert each.dt == pytest.approx(0.04)
    np.testing.assert_allclose(shown[0].positions, shown[1].positions, atol=1e-3)


def test_playground_environments_can_be_shown() -> None:
    playground = pytest.importorskip("mujoco_playground")
    env = playground.registry.load("CartpoleBalance", config_overrides={"impl": "jax"})
    n, p = env.observation_size, env.action_size
    still = dataclasses.replace(
        push(0.0), weights=np.zeros((p, n)), mean=np.zeros(n), std=np.ones(n)
    )
    shown = replay(still, env=env, seconds=3 * env.dt)
    assert shown.positions.shape == (4, env.mj_model.nq)
