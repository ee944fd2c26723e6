"""The frames of a video: pictures of episodes below captions, side by side."""

from collections.abc import Callable, Iterator, Sequence

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from ailsrs_jax.show.episodes.renderer import pictures
from ailsrs_jax.show.episodes.replay import Film, Replay

COLUMNS = 4  # of pictures
GAP = 4  # pixels between them
INK, PALE, DARK, WARM = "#f8fafc", "#94a3b8", "#0f172a", "#fbbf24"

Watch = Callable[[int, int], object]  # receives how many pictures are done, of how many


def unwatched(done: int, total: int) -> None:
    """Show no progress."""


def frames_of(
    replays: Sequence[Replay | Film],
    labels: Sequence[str],
    steps: Sequence[int],
    size: int,
    watch: Watch,
    *,
    facts: Sequence[str | None] | None = None,
    colors: Sequence[str] | None = None,
) -> np.ndarray:
    """Return ``(T, H, W, 3)`` uint8: the episodes after each of ``steps`` steps, side by side.

    Each picture is ``size`` pixels high and wide. The caption above it is a label, in its color,
    and a fact, which is by default the return so far and the time. ``watch`` is called after each
    picture.

    Raises:
        UserError: there is no renderer.
    """
    # One video at a time: two open renderers would switch their OpenGL context every frame.
    videos: list[np.ndarray] = []
    facts, colors = facts or [None] * len(replays), colors or [INK] * len(replays)
    episodes = zip(replays, labels, facts, colors, strict=True)
    for number, (replay, label, fact, color) in enumerate(episodes):
        shown = []
        for picture in _captioned_pictures(replay, label, steps, size, fact, color):
            shown.append(picture)
            watch(number * len(steps) + len(shown), len(replays) * len(steps))
        videos.append(np.stack(shown))
    return side_by_side(videos)


def side_by_side(videos: Sequence[np.ndarray]) -> np.ndarray:
    """Arrange videos ``(T, h, w, 3)`` of the same shape in rows of at most ``COLUMNS``."""
    num_frames, height, width, _ = videos[0].shape
    columns = min(len(videos), COLUMNS)
    rows = -(-len(videos) // columns)
    shape = (num_frames, rows * (height + GAP) - GAP, columns * (width + GAP) - GAP, 3)
    together = np.empty(shape, np.uint8)
    together[:] = tuple(bytes.fromhex(DARK[1:]))
    for index, video in enumerate(videos):
        top, left = index // columns * (height + GAP), index % columns * (width + GAP)
        together[:, top : top + height, left : left + width] = video
    return together


def _captioned_pictures(
    replay: Replay | Film, label: str, steps: Sequence[int], size: int, fact: str | None, color: str
) -> Iterator[np.ndarray]:
    """Yield the pictures at ``steps`` below a caption: the label, and ``fact`` or the return.

    After the end of the episode the last picture stays, darker if the final state was terminal.
    """
    returns = np.concatenate([[0.0], np.cumsum(replay.env_rewards, dtype=np.float64)])
    live = [step for step in steps if step <= replay.num_steps]
    drawn = pictures(replay, [*live, replay.num_steps], size)

    bar = 2 * max(size // (14 if fact else 22), 8)  # pixels above, where no controls hide it
    font = ImageFont.load_default(size=bar * 0.42)

    def captioned(picture: np.ndarray, step: int, *, ended: bool = False) -> np.ndarray:
        text, tone = fact or f"return {returns[step]:.0f}   {step * replay.dt:.1f} s", PALE
        if ended and not fact:
            text, tone = f"ended: {text}", WARM
        image = Image.new("RGB", (size, size + bar), DARK)
        image.paste(Image.fromarray(picture), (0, bar))
        draw, margin = ImageDraw.Draw(image), bar * 0.4
        draw.text((margin, bar / 2), label, color, font, anchor="lm")
        draw.text((size - margin, bar / 2), text, tone, font, anchor="rm")
        return np.asarray(image)

    for step in live:
        yield captioned(next(drawn), step)
    if rest := len(steps) - len(live):
        last = next(drawn) // (2 if replay.ended else 1)
        yield from [captioned(last, replay.num_steps, ended=replay.ended)] * rest
