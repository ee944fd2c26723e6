"""Seeing what a policy does: as MP4, in a notebook, or in Brax's interactive viewer."""

import base64
import dataclasses
import functools
import io
from collections.abc import Iterator, Sequence
from fractions import Fraction
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from ailsrs_jax.data.policies import SavedPolicy, expert_path, load_policy, policy_files
from ailsrs_jax.envs import Env
from ailsrs_jax.envs.registry import require_harmless
from ailsrs_jax.errors import UserError
from ailsrs_jax.files import require_writable, write_atomically
from ailsrs_jax.runs.storage.config import read_config
from ailsrs_jax.show.renderer import pictures, require_renderer
from ailsrs_jax.show.replay import Replay, replay
from ailsrs_jax.show.viewer import viewer_html

SUFFIXES = (".mp4", ".html")
MOST_FPS = 60  # of many more steps in a second only every k-th is drawn
SECONDS, SIZE = 10.0, 480
COLUMNS = 4  # of pictures
GAP = 4  # pixels between them
INK, PALE, DARK, WARM = (248, 250, 252), (148, 163, 184), (15, 23, 42), (251, 191, 36)


@dataclasses.dataclass(frozen=True, eq=False)
class Animation:
    """Episodes side by side, in real time. A notebook that shows it plays the video.

    Attributes:
        replays: the episodes, of one task.
        labels: what to call each.
        size: height and width of each picture in pixels.
    """

    replays: Sequence[Replay]
    labels: Sequence[str]
    size: int = SIZE

    @property
    def stride(self) -> int:
        """Environment steps from one frame to the next."""
        return int(np.ceil(1 / (MOST_FPS * self.replays[0].dt) - 1e-6)) or 1

    @property
    def fps(self) -> Fraction:
        """Frames per second, so that simulated time goes as fast as real time."""
        return 1 / (Fraction(self.replays[0].dt * self.stride).limit_denominator(10_000))

    @functools.cached_property
    def frames(self) -> np.ndarray:
        """``(T, H, W, 3)`` uint8.

        Raises:
            UserError: there is no renderer.
        """
        last = max(replay.num_steps for replay in self.replays)
        steps = range(0, last + 1, self.stride)
        streams = [
            _panels(replay, label, steps, self.size)
            for replay, label in zip(self.replays, self.labels, strict=True)
        ]
        # One renderer at a time: those of two models would take turns for every frame.
        return side_by_side([np.stack(list(stream)) for stream in streams])

    @functools.cached_property
    def mp4(self) -> bytes:
        """The video, H.264.

        Raises:
            UserError: there is no renderer, or PyAV is missing.
        """
        require_encoder()
        return encode(self.frames, self.fps)

    def save(self, path: str | Path) -> None:
        """Write ``.mp4``, or ``.html``, which is Brax's viewer and needs no renderer.

        Raises:
            UserError: another suffix, no renderer, no PyAV, or a place that cannot be written.
        """
        path = Path(path)
        require_suffix(path)
        content = self.mp4 if path.suffix == ".mp4" else self.viewer().encode()
        write_atomically(path, lambda file: file.write(content))

    def viewer(self) -> str:
        """Brax's viewer as a page of HTML; whoever opens it needs the internet."""
        return viewer_html(self.replays, self.labels)

    def _repr_html_(self) -> str:
        """What a notebook shows."""
        height, width = self.frames.shape[1:3]
        return (
            f'<video controls autoplay loop muted playsinline width="{width}" height="{height}" '
            f'style="max-width:100%;height:auto" src="{self.data_uri}"></video>'
        )

    @property
    def data_uri(self) -> str:
        """The video as an address that holds it."""
        return data_uri("video/mp4", self.mp4)


def render(
    policy: SavedPolicy | str | Path,
    output: str | Path | None = None,
    *,
    expert: SavedPolicy | str | Path | None = None,
    alone: bool = False,
    env: Env | None = None,
    physics: str = "auto",
    seed: int = 0,
    seconds: float = SECONDS,
    size: int = SIZE,
) -> Animation:
    """Show one episode of ``policy``, beside the expert's from the same initial state.

    Args:
        policy: the policy, its file, or a run directory, of which the first seed is shown.
        output: write ``.mp4``, or ``.html``, which is Brax's interactive viewer. Without it nothing
            is written: in a notebook, the value plays.
        expert: the expert or its file; without it the one that ships with the package, if one does.
        alone: show no expert.
        env: an environment that MuJoCo simulates; without it, the task that the policy names.
        physics: ``auto``, ``mjx`` or ``mujoco``, where the task is given by its name.
        seed: of the initial state.
        seconds: show at most so much of the episode.
        size: height and width of each picture in pixels.

    Returns:
        The animation; its ``frames`` are an array, its ``save`` writes it once more.

    Raises:
        UserError: something handed in is wrong, MuJoCo does not simulate the task, there is no
            renderer, or PyAV is missing.
    """
    if not 16 <= size <= 4096 or size % 2:
        raise UserError(f"size is {size}: it must be an even number from 16 to 4096")
    if output is not None:
        output = Path(output)
        require_suffix(output)
        require_writable(output)
    shown = {"policy": _load(policy, env)}
    if not alone and (beside := _find_expert(policy, shown["policy"], expert)) is not None:
        shown = {"expert": _load(beside, env)} | shown
        env_ids = {each.env_id for each in shown.values()}
        if env is None and len(env_ids) > 1:
            raise UserError(
                f"the expert is of {shown['expert'].env_id}, the policy of "
                f"{shown['policy'].env_id}: give one of the same task, or show the policy alone"
            )
    if output is None or output.suffix == ".mp4":
        require_encoder()
        require_renderer()
    replays = [
        replay(each, env=env, physics=physics, seed=seed, seconds=seconds)
        for each in shown.values()
    ]
    animation = Animation(replays, list(shown), size)
    if output is not None:
        animation.save(output)
    return animation


def _load(policy: SavedPolicy | str | Path, env: Env | None) -> SavedPolicy:
    if isinstance(policy, SavedPolicy):
        return policy
    path = policy_files(Path(policy))[0]
    loaded = load_policy(path)
    if env is None:
        require_harmless(loaded.env_id, str(path))
    return loaded


def _find_expert(
    policy: SavedPolicy | str | Path, loaded: SavedPolicy, expert: SavedPolicy | str | Path | None
) -> SavedPolicy | str | Path | None:
    """The expert that is asked for, or else the one that ships with the package, if one does."""
    if expert is not None:
        return expert
    try:
        return expert_path(loaded.env_id, of_paper=_imitates_paper(policy))
    except UserError:
        return None


def _imitates_paper(policy: SavedPolicy | str | Path) -> bool:
    """Whether it is a run that was given the expert of the paper's return."""
    if isinstance(policy, SavedPolicy) or not (path := Path(policy) / "config.json").is_file():
        return False
    source = read_config(path).get("source")
    kind, name = (source.get(key) if isinstance(source, dict) else None for key in ("kind", "name"))
    return (kind, name) == ("expert", "paper")


def require_suffix(path: Path) -> None:
    """Raise UserError unless we write files that are called like that."""
    if path.suffix not in SUFFIXES:
        raise UserError(f"{path}: the name has to end in {' or '.join(SUFFIXES)}")


def data_uri(kind: str, content: bytes) -> str:
    """An address that holds a file of that kind."""
    return f"data:{kind};base64,{base64.b64encode(content).decode()}"


def require_encoder() -> None:
    """Raise UserError unless PyAV is installed."""
    try:
        import av  # noqa: F401
    except ImportError:
        raise UserError("no video: MP4 needs pip install 'ailsrs_jax[video]'") from None


def encode(frames: np.ndarray, fps: Fraction) -> bytes:
    """``frames (T, H, W, 3)`` uint8, H and W even, as the bytes of an MP4 file."""
    import av

    file = io.BytesIO()
    with av.open(file, "w", format="mp4") as container:
        stream = container.add_stream("libx264", rate=fps, options={"crf": "21"})
        stream.height, stream.width = frames.shape[1:3]
        stream.pix_fmt = "yuv420p"  # which every browser plays
        for frame in frames:
            picture = av.VideoFrame.from_ndarray(np.ascontiguousarray(frame), format="rgb24")
            container.mux(stream.encode(picture))
        container.mux(stream.encode())
    return file.getvalue()


def side_by_side(panels: Sequence[np.ndarray]) -> np.ndarray:
    """Videos ``(T, h, w, 3)`` of the same shape in rows of at most ``COLUMNS``."""
    num_frames, height, width, _ = panels[0].shape
    columns = min(len(panels), COLUMNS)
    rows = -(-len(panels) // columns)
    shape = (rows * (height + GAP) - GAP, columns * (width + GAP) - GAP)
    together = np.full((num_frames, *shape, 3), DARK, np.uint8)
    for index, panel in enumerate(panels):
        row, column = divmod(index, columns)
        top, left = row * (height + GAP), column * (width + GAP)
        together[:, top : top + height, left : left + width] = panel
    return together


def _panels(replay: Replay, label: str, steps: Sequence[int], size: int) -> Iterator[np.ndarray]:
    """The pictures at ``steps`` below a caption: label, return so far, time.

    Where the episode is over, its last picture stays, darker if it ended in a terminal state.
    """
    returns = np.concatenate([[0.0], np.cumsum(replay.env_rewards, dtype=np.float64)])
    live = [step for step in steps if step <= replay.num_steps]
    drawn = pictures(replay, [*live, replay.num_steps], size)
    for step in live:
        text = f"return {returns[step]:.0f}   {step * replay.dt:.1f} s"
        yield _captioned(next(drawn), label, text, PALE)
    rest = len(steps) - len(live)
    if rest:
        last = next(drawn)
        end = f"{replay.num_steps * replay.dt:.1f} s"
        text, color = f"return {returns[-1]:.0f}   {end}", PALE
        if replay.ended:
            last, text, color = last // 2, f"ended: return {returns[-1]:.0f}   {end}", WARM
        frozen = _captioned(last, label, text, color)
        yield from [frozen] * rest


def _captioned(
    picture: np.ndarray, label: str, text: str, color: tuple[int, int, int]
) -> np.ndarray:
    """The picture with a line above it, of even height: a player's controls hide what is below."""
    height, width = picture.shape[:2]
    bar = 2 * max(height // 22, 8)
    image = Image.new("RGB", (width, height + bar), DARK)
    image.paste(Image.fromarray(picture), (0, bar))
    draw, font = ImageDraw.Draw(image), ImageFont.load_default(size=bar * 0.42)
    middle, margin = bar / 2, bar * 0.4
    draw.text((margin, middle), label, INK, font, anchor="lm")
    draw.text((width - margin, middle), text, color, font, anchor="rm")
    return np.asarray(image)
