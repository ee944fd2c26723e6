"""Episodes of policies as an MP4 video, in a notebook, or in Brax's interactive viewer."""

import base64
import dataclasses
import functools
import io
from collections.abc import Iterator, Sequence
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
from PIL import Image, ImageDraw, ImageFont

from ailsrs_jax.data.policies import SavedPolicy, expert_path, load_policy, policy_files
from ailsrs_jax.data.sources import Source, parse_source
from ailsrs_jax.envs import Env
from ailsrs_jax.errors import UserError
from ailsrs_jax.files import require_writable, write_atomically
from ailsrs_jax.runs.horizon import policy_horizon
from ailsrs_jax.runs.storage.config import read_config
from ailsrs_jax.show.renderer import pictures, require_renderer
from ailsrs_jax.show.replay import Film, Replay, replay
from ailsrs_jax.show.viewer import viewer_html

SUFFIXES = (".mp4", ".html")
MOST_FPS = 60  # above this only every k-th step is drawn
SECONDS, SIZE = 10.0, 480
COLUMNS = 4  # of pictures
GAP = 4  # pixels between them
INK, PALE, DARK, WARM = (248, 250, 252), (148, 163, 184), (15, 23, 42), (251, 191, 36)

PolicyOrPath = SavedPolicy | str | Path


@dataclasses.dataclass(frozen=True, eq=False)
class Animation:
    """Episodes side by side in real time; a notebook plays it as a video.

    Attributes:
        replays: the episodes, all of one task.
        labels: a label for each episode.
        size: height and width of each picture in pixels.
    """

    replays: Sequence[Replay | Film]
    labels: Sequence[str]
    size: int = SIZE

    @property
    def stride(self) -> int:
        """Environment steps from one frame to the next."""
        return int(np.ceil(1 / (MOST_FPS * self.replays[0].dt) - 1e-6)) or 1

    @property
    def fps(self) -> Fraction:
        """Frames per second, so that simulated time passes in real time."""
        return 1 / (Fraction(self.replays[0].dt * self.stride).limit_denominator(10_000))

    @functools.cached_property
    def frames(self) -> np.ndarray:
        """``(T, H, W, 3)`` uint8.

        Raises:
            UserError: there is no renderer.
        """
        last = max(replay.num_steps for replay in self.replays)
        steps = range(0, last + 1, self.stride)
        # One video at a time: two open renderers would switch their OpenGL context every frame.
        videos = [
            np.stack(list(_captioned_pictures(replay, label, steps, self.size)))
            for replay, label in zip(self.replays, self.labels, strict=True)
        ]
        return side_by_side(videos)

    @functools.cached_property
    def mp4(self) -> bytes:
        """The video, H.264.

        Raises:
            UserError: there is no renderer.
        """
        return encode(self.frames, self.fps)

    @property
    def data_uri(self) -> str:
        """The video as a data address."""
        return data_uri("video/mp4", self.mp4)

    def viewer(self) -> str:
        """Return Brax's viewer as an HTML page, which loads its scripts from the internet.

        Raises:
            UserError: an environment of Gymnasium draws itself.
        """
        replays = [replay for replay in self.replays if isinstance(replay, Replay)]
        if len(replays) < len(self.replays):
            raise UserError("the viewer shows MuJoCo models: for this environment write an .mp4")
        return viewer_html(replays, self.labels)

    def save(self, path: str | Path) -> None:
        """Write ``.mp4``, or ``.html`` with Brax's viewer, which needs no renderer.

        Raises:
            UserError: another suffix, no renderer, or the file cannot be written.
        """
        path = Path(path)
        require_suffix(path)
        content = self.mp4 if path.suffix == ".mp4" else self.viewer().encode()
        write_atomically(path, content)

    def _repr_html_(self) -> str:
        """Return what a notebook shows."""
        height, width = self.frames.shape[1:3]
        return (
            f'<video controls autoplay loop muted playsinline width="{width}" height="{height}" '
            f'style="max-width:100%;height:auto" src="{self.data_uri}"></video>'
        )


def render(
    policy: PolicyOrPath,
    output: str | Path | None = None,
    *,
    expert: PolicyOrPath | None = None,
    alone: bool = False,
    env: Env | None = None,
    physics: str = "auto",
    seed: int = 0,
    seconds: float = SECONDS,
    size: int = SIZE,
) -> Animation:
    """Show one episode of ``policy`` beside the expert's from the same initial state.

    Args:
        policy: the policy, its file, or a run directory, whose first seed is shown.
        output: an ``.mp4`` file, or an ``.html`` file with Brax's interactive viewer. Without it
            nothing is written; a notebook plays the returned value.
        expert: the expert or its file; by default the shipped expert of the task, if there is one.
        alone: do not show an expert.
        env: an environment that MuJoCo simulates; by default the task that the policy names.
        physics: ``auto``, ``mjx`` or ``mujoco``, for a task given by its name.
        seed: seed of the initial state.
        seconds: longest part of the episode to show.
        size: height and width of each picture in pixels.

    Returns:
        The animation. Its ``frames`` are an array; ``save`` writes it to another file.

    Raises:
        UserError: an argument is wrong, MuJoCo does not simulate the task, or there is no
            renderer.
    """
    if not 16 <= size <= 4096 or size % 2:
        raise UserError(f"size is {size}: it must be an even number from 16 to 4096")
    if output is not None:
        output = Path(output)
        require_suffix(output)
        require_writable(output)
    shown = {"policy": _load(policy)}
    if not alone and (beside := _find_expert(policy, shown["policy"], expert)) is not None:
        shown = {"expert": beside} | shown
        if env is None and beside.env_id != shown["policy"].env_id:
            raise UserError(
                f"the expert is of {beside.env_id}, the policy of {shown['policy'].env_id}: give "
                "an expert of the same task, or show the policy alone"
            )
    if output is None or output.suffix == ".mp4":
        require_renderer()
    length = None if isinstance(policy, SavedPolicy) else policy_horizon(_file(policy))
    replays = [
        replay(each, env=env, physics=physics, seed=seed, seconds=seconds, episode_length=length)
        for each in shown.values()
    ]
    animation = Animation(replays, list(shown), size)
    if output is not None:
        animation.save(output)
    return animation


def shipped_expert(env_id: str, *imitated: Source | None) -> SavedPolicy | None:
    """Return the shipped expert of the task, if any; the paper's if a run ``imitated`` it."""
    try:
        return load_policy(expert_path(env_id, of_paper=Source("expert", "paper") in imitated))
    except UserError:
        return None


def _find_expert(
    policy: PolicyOrPath, loaded: SavedPolicy, expert: PolicyOrPath | None
) -> SavedPolicy | None:
    """Return the expert that was asked for, else the one that ships for the task, if any."""
    if expert is not None:
        return _load(expert)
    imitated = None
    if not isinstance(policy, SavedPolicy) and (path := Path(policy) / "config.json").is_file():
        imitated = parse_source(read_config(path).get("source"), str(path))
    return shipped_expert(loaded.env_id, imitated)


def _load(policy: PolicyOrPath) -> SavedPolicy:
    if isinstance(policy, SavedPolicy):
        return policy
    return load_policy(_file(policy))


def _file(policy: str | Path) -> Path:
    return policy_files(Path(policy))[0]


def require_suffix(path: Path) -> None:
    """Raise UserError unless the file name ends in a suffix that can be written."""
    if path.suffix not in SUFFIXES:
        raise UserError(f"{path}: the name must end in {' or '.join(SUFFIXES)}")


def encode(frames: np.ndarray, fps: Fraction) -> bytes:
    """Encode ``frames (T, H, W, 3)`` uint8, H and W even, as an MP4 file."""
    file = io.BytesIO()
    with av.open(file, "w", format="mp4") as container:
        stream = container.add_stream("libx264", rate=fps, options={"crf": "21"})
        stream.height, stream.width = frames.shape[1:3]
        stream.pix_fmt = "yuv420p"  # every browser plays it
        for frame in frames:
            picture = av.VideoFrame.from_ndarray(np.ascontiguousarray(frame), format="rgb24")
            container.mux(stream.encode(picture))
        container.mux(stream.encode())
    return file.getvalue()


def data_uri(kind: str, content: bytes) -> str:
    """Return a data address that holds a file of the MIME type ``kind``."""
    return f"data:{kind};base64,{base64.b64encode(content).decode()}"


def side_by_side(videos: Sequence[np.ndarray]) -> np.ndarray:
    """Arrange videos ``(T, h, w, 3)`` of the same shape in rows of at most ``COLUMNS``."""
    num_frames, height, width, _ = videos[0].shape
    columns = min(len(videos), COLUMNS)
    rows = -(-len(videos) // columns)
    shape = (num_frames, rows * (height + GAP) - GAP, columns * (width + GAP) - GAP, 3)
    together = np.full(shape, DARK, np.uint8)
    for index, video in enumerate(videos):
        top, left = index // columns * (height + GAP), index % columns * (width + GAP)
        together[:, top : top + height, left : left + width] = video
    return together


def _captioned_pictures(
    replay: Replay | Film, label: str, steps: Sequence[int], size: int
) -> Iterator[np.ndarray]:
    """Yield the pictures at ``steps`` below a caption: label, return so far, time.

    After the end of the episode the last picture stays, darker if the final state was terminal.
    """
    returns = np.concatenate([[0.0], np.cumsum(replay.env_rewards, dtype=np.float64)])
    live = [step for step in steps if step <= replay.num_steps]
    drawn = pictures(replay, [*live, replay.num_steps], size)

    def facts(step: int) -> str:
        return f"return {returns[step]:.0f}   {step * replay.dt:.1f} s"

    for step in live:
        yield _captioned(next(drawn), label, facts(step), PALE)
    if rest := len(steps) - len(live):
        last, text, color = next(drawn), facts(replay.num_steps), PALE
        if replay.ended:
            last, text, color = last // 2, f"ended: {text}", WARM
        yield from [_captioned(last, label, text, color)] * rest


def _captioned(
    picture: np.ndarray, label: str, text: str, color: tuple[int, int, int]
) -> np.ndarray:
    """Add a line of text above, where a player's controls do not hide it; its height is even."""
    height, width = picture.shape[:2]
    bar = 2 * max(height // 22, 8)
    image = Image.new("RGB", (width, height + bar), DARK)
    image.paste(Image.fromarray(picture), (0, bar))
    draw, font = ImageDraw.Draw(image), ImageFont.load_default(size=bar * 0.42)
    middle, margin = bar / 2, bar * 0.4
    draw.text((margin, middle), label, INK, font, anchor="lm")
    draw.text((width - margin, middle), text, color, font, anchor="rm")
    return np.asarray(image)
