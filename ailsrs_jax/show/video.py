"""Episodes of policies as an MP4 video, in a notebook, or in Brax's interactive viewer."""

import base64
import dataclasses
import functools
import io
import math
from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
from PIL import Image

from ailsrs_jax.data.policies import SavedPolicy, expert_path, load_policy, policy_files
from ailsrs_jax.data.sources import Source, parse_source
from ailsrs_jax.envs import Env
from ailsrs_jax.errors import UserError
from ailsrs_jax.files import require_writable, write_atomically
from ailsrs_jax.runs.horizon import policy_horizon
from ailsrs_jax.runs.storage.config import read_config
from ailsrs_jax.runs.storage.saved_run import SavedRun
from ailsrs_jax.show.episodes.frames import Watch, frames_of, unwatched
from ailsrs_jax.show.episodes.renderer import require_renderer
from ailsrs_jax.show.episodes.replay import Film, Replay, replay
from ailsrs_jax.show.episodes.viewer import viewer_html

SUFFIXES = (".mp4", ".webp", ".html")
MOST_FPS = 60  # above this only every k-th step is drawn
SECONDS, SIZE = 10.0, 480
WEBP_FPS = 25  # at most; only every k-th frame is written
WEBP_QUALITY = 25  # at most 100; with 50 a file is twice as large

PolicyOrPath = SavedPolicy | str | Path


@dataclasses.dataclass(frozen=True, eq=False)
class Animation:
    """Episodes side by side in real time; a notebook plays it as a video.

    Attributes:
        replays: the episodes, all of one task.
        labels: a label for each episode.
        size: height and width of each picture in pixels.
        watch: called with the number of pictures that are drawn, and that of all.
    """

    replays: Sequence[Replay | Film]
    labels: Sequence[str]
    size: int = SIZE
    watch: Watch = unwatched

    @property
    def stride(self) -> int:
        """Environment steps from one frame to the next."""
        return int(np.ceil(1 / (MOST_FPS * self.replays[0].dt) - 1e-6)) or 1

    @property
    def fps(self) -> Fraction:
        """Frames per second, so that simulated time passes in real time."""
        return 1 / (Fraction(self.replays[0].dt * self.stride).limit_denominator(10_000))

    @property
    def steps(self) -> Sequence[int]:
        """The environment step of each frame."""
        last = max(replay.num_steps for replay in self.replays)
        return range(0, last + 1, self.stride)

    @functools.cached_property
    def frames(self) -> np.ndarray:
        """``(T, H, W, 3)`` uint8.

        Raises:
            UserError: there is no renderer.
        """
        return frames_of(self.replays, self.labels, self.steps, self.size, self.watch)

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
        """Write ``.mp4``, ``.webp``, or ``.html`` with Brax's viewer, which needs no renderer.

        Raises:
            UserError: another suffix, no renderer, or the file cannot be written.
        """
        path = Path(path)
        require_suffix(path)
        if path.suffix == ".html":
            content = self.viewer().encode()
        else:
            content = self.mp4 if path.suffix == ".mp4" else encode_webp(self.frames, self.fps)
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
    watch: Watch = unwatched,
) -> Animation:
    """Show one episode of ``policy`` beside the expert's from the same initial state.

    Args:
        policy: the policy, its file, or a run directory, whose first seed is shown.
        output: an ``.mp4`` or ``.webp`` file, or an ``.html`` file with Brax's interactive viewer.
            Without it nothing is written; a notebook plays the returned value.
        expert: the expert or its file; by default the shipped expert of the task, if there is one.
        alone: do not show an expert.
        env: an environment that MuJoCo simulates; by default the task that the policy names.
        physics: ``auto``, ``mjx`` or ``mujoco``, for a task given by its name.
        seed: seed of the initial state.
        seconds: longest part of the episode to show.
        size: height and width of each picture in pixels.
        watch: called with the number of pictures that are drawn, and that of all.

    Returns:
        The animation. Its ``frames`` are an array; ``save`` writes it to another file.

    Raises:
        UserError: an argument is wrong, MuJoCo does not simulate the task, or there is no
            renderer.
    """
    output = None if output is None else Path(output)
    require_output(output, size)
    shown = {"policy": _load(policy)}
    if not alone and (beside := find_expert(policy, shown["policy"], expert)) is not None:
        shown = {"expert": beside} | shown
        if env is None and beside.env_id != shown["policy"].env_id:
            raise UserError(
                f"the expert is of {beside.env_id}, the policy of {shown['policy'].env_id}: give "
                "an expert of the same task, or show the policy alone"
            )
    if output is None or output.suffix != ".html":
        require_renderer()
    length = (
        None if isinstance(policy, SavedPolicy) else policy_horizon(policy_files(Path(policy))[0])
    )
    replays = [
        replay(each, env=env, physics=physics, seed=seed, seconds=seconds, episode_length=length)
        for each in shown.values()
    ]
    animation = Animation(replays, list(shown), size, watch)
    if output is not None:
        animation.save(output)
    return animation


def shipped_expert(env_id: str, *imitated: Source | None) -> SavedPolicy | None:
    """Return the shipped expert of the task, if any; the one that a run ``imitated``, if named."""
    names = (each.name for each in imitated if each is not None and each.kind == "expert")
    try:
        return load_policy(expert_path(env_id, next(filter(None, names), None)))
    except UserError:
        return None


def find_expert(
    policy: PolicyOrPath, loaded: SavedPolicy, expert: PolicyOrPath | None
) -> SavedPolicy | None:
    """Return the expert that was asked for, else the one that ships for the task, if any."""
    if expert is not None:
        return _load(expert)
    imitated = None
    if not isinstance(policy, SavedPolicy) and (path := Path(policy) / "config.json").is_file():
        imitated = parse_source(read_config(path).get("source"), str(path))
    return shipped_expert(loaded.env_id, imitated)


def load_of(run: SavedRun, path: Path) -> SavedPolicy:
    """Load a policy of ``run``; raise UserError if it is damaged, or of another task."""
    policy = load_policy(path)
    if policy.env_id != run.config["env_id"]:
        raise UserError(f"{path} is of {policy.env_id}, not of the run's task")
    return policy


def _load(policy: PolicyOrPath) -> SavedPolicy:
    if isinstance(policy, SavedPolicy):
        return policy
    return load_policy(policy_files(Path(policy))[0])


def require_output(output: Path | None, size: int) -> None:
    """Raise UserError unless pictures can have this ``size``, and the file can be written."""
    if not 16 <= size <= 4096 or size % 2:
        raise UserError(f"size is {size}: it must be an even number from 16 to 4096")
    if output is not None:
        require_suffix(output)
        require_writable(output)


def require_suffix(path: Path) -> None:
    """Raise UserError unless the file name ends in a suffix that can be written."""
    if path.suffix not in SUFFIXES:
        raise UserError(f"{path}: the name must end in {', '.join(SUFFIXES[:-1])} or .html")


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


def encode_webp(frames: np.ndarray, fps: Fraction) -> bytes:
    """Encode ``frames (T, H, W, 3)`` uint8 as an animated picture, which a README shows."""
    every = math.ceil(fps / WEBP_FPS)
    first, *others = map(Image.fromarray, frames[::every])
    file = io.BytesIO()
    first.save(
        file,
        "WEBP",
        save_all=True,
        append_images=others,
        duration=round(1000 * every / fps),  # milliseconds
        loop=0,
        quality=WEBP_QUALITY,
        method=6,  # the slowest and smallest
    )
    return file.getvalue()


def data_uri(kind: str, content: bytes) -> str:
    """Return a data address that holds a file of the MIME type ``kind``."""
    return f"data:{kind};base64,{base64.b64encode(content).decode()}"
