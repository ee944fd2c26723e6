"""Policies of several iterations of a run: a film of them, and a page on which they run."""

import dataclasses
import functools
import io
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from PIL import Image

from ailsrs_jax.data.policies import SavedPolicy, load_policy, policy_files
from ailsrs_jax.errors import UserError
from ailsrs_jax.files import require_file, require_writable, write_atomically
from ailsrs_jax.runs.horizon import policy_horizon
from ailsrs_jax.runs.storage.metrics import percentage
from ailsrs_jax.runs.storage.policies import EVALUATED, MILESTONES
from ailsrs_jax.runs.storage.saved_run import SavedRun, read_run
from ailsrs_jax.show.episodes.frames import DARK, INK, PALE, Watch, frames_of, unwatched
from ailsrs_jax.show.episodes.play import play_html, require_playable
from ailsrs_jax.show.episodes.renderer import require_renderer
from ailsrs_jax.show.episodes.replay import replay
from ailsrs_jax.show.style import encoded
from ailsrs_jax.show.video import (
    SECONDS,
    Animation,
    PolicyOrPath,
    find_expert,
    load_of,
    require_output,
)

COLORS = ("#94a3b8", "#38bdf8", "#34d399", "#fbbf24")  # of the policies, the kept one is last
PICTURE_SIZE = 240
CURVE_HEIGHT = 0.7  # of a picture's
DRAWN_AFTER = 0.75  # of the film; the rest of it shows the whole curve
INCHES = 2.4  # of a picture
PARTS = ("axes.labelcolor", "axes.edgecolor", "xtick.color", "ytick.color")
PALE_AXES: Any = dict.fromkeys(PARTS, PALE)


@dataclasses.dataclass(frozen=True, eq=False)
class LearningFilm(Animation):
    """Episodes of policies of one run, and below them its learning curve, which draws itself.

    Attributes:
        values: how good the policy of each iteration is, as it was measured in training.
        unit: of these.
        iterations: those of the episodes.
    """

    values: np.ndarray = dataclasses.field(kw_only=True)
    unit: Literal["% of the expert", "return"] = dataclasses.field(kw_only=True)
    iterations: list[int] = dataclasses.field(kw_only=True)

    @functools.cached_property
    def frames(self) -> np.ndarray:
        """``(T, H, W, 3)`` uint8.

        Raises:
            UserError: there is no renderer.
        """
        colors = COLORS[-len(self.iterations) :]
        form = "return {:.0f}" if self.unit == "return" else f"{{:.0f}} {self.unit}"
        facts = list(map(form.format, self.values[self.iterations]))
        above = frames_of(
            self.replays, self.labels, self.steps, self.size, self.watch, facts=facts, colors=colors
        )
        num_frames, _, width, _ = above.shape
        height = 2 * round(CURVE_HEIGHT * self.size / 2)
        empty, drawn = (self._curve(width, height, colors, shown) for shown in (False, True))
        ends = np.linspace(0, width / DRAWN_AFTER, num_frames).astype(int)
        is_drawn = np.arange(width) < ends[:, None]
        below = np.where(is_drawn[:, None, :, None], drawn, empty)
        return np.concatenate([above, below], axis=1)

    def _curve(self, width: int, height: int, colors: tuple[str, ...], shown: bool) -> np.ndarray:
        """Draw the values of all iterations, or only the axes, ``(height, width, 3)`` uint8."""
        with matplotlib.rc_context(PALE_AXES):
            dpi = self.size / INCHES  # letters grow with the pictures
            figure = Figure(((width + 0.5) / dpi, (height + 0.5) / dpi), facecolor=DARK)
            figure.set_layout_engine("constrained", w_pad=0.12, h_pad=0.1)
            axes = figure.add_subplot(facecolor=DARK)
            if self.unit != "return":
                axes.axhline(100, color=PALE, linestyle="--", linewidth=1)
            axes.plot(self.values, color=INK, linewidth=1.5, visible=shown)
            at = self.iterations
            axes.scatter(at, self.values[at], c=colors, s=60, zorder=3, visible=shown)
            axes.set(xlabel="iteration", ylabel=self.unit)
            axes.spines[["top", "right"]].set_visible(False)
            picture = Image.open(io.BytesIO(encoded(figure, "png", dpi=dpi)))
        return np.asarray(picture.convert("RGB"))


def film_learning(
    policy: Path,
    output: Path,
    *,
    physics: str = "auto",
    seed: int = 0,
    seconds: float = SECONDS,
    size: int = PICTURE_SIZE,
    watch: Watch = unwatched,
) -> LearningFilm:
    """Show how a run learned: its first policy, two between, and the kept one.

    ``policy`` is a run directory, whose first seed is shown, or the ``policy.npz`` of another seed.
    ``output`` is an ``.mp4`` or ``.webp`` file. All episodes share the initial state. The other
    arguments are those of :func:`~ailsrs_jax.show.video.render`.

    Raises:
        UserError: an argument is wrong, the run did not store its policies, MuJoCo does not
            simulate the task, or there is no renderer.
    """
    if output.suffix == ".html":
        raise UserError(f"{output}: a film of the learning is an .mp4 or a .webp")
    require_output(output, size)
    kept_file = policy_files(policy)[0].absolute()
    require_file(kept_file)
    seed_directory = kept_file.parent
    run = read_run(seed_directory.parent)
    files, returns = stored_policies(run, seed_directory)
    iterations = choose({iteration: returns[iteration] for iteration in files})
    policies = [load_of(run, files[iteration]) for iteration in iterations]
    require_renderer()
    expert = run.comparable_expert_return or 0.0
    length = policy_horizon(kept_file)
    film = LearningFilm(
        replays=[
            replay(each, physics=physics, seed=seed, seconds=seconds, episode_length=length)
            for each in policies
        ],
        labels=[f"iteration {iteration}" for iteration in iterations],
        size=size,
        watch=watch,
        values=100 * returns / expert if expert > 0 else returns,
        unit="% of the expert" if expert > 0 else "return",
        iterations=iterations,
    )
    film.save(output)
    return film


def write_play(
    policy: Path,
    output: Path,
    *,
    expert: PolicyOrPath | None = None,
    alone: bool = False,
    seed: int = 0,
) -> list[str]:
    """Write a page that runs a policy, and the earlier ones of its run, in the browser.

    Args:
        policy: a policy file, or a run directory, whose first seed is shown.
        output: an ``.html`` file.
        expert: the expert or its file; by default the shipped expert of the task, if there is one.
        alone: leave the expert out.
        seed: of the initial states.

    Returns:
        What the page calls the policies.

    Raises:
        UserError: an argument is wrong, the page does not know the task, a file is damaged, or npm
            cannot fetch MuJoCo's WebAssembly build.
    """
    if output.suffix != ".html":
        raise UserError(f"{output}: --play writes a page, whose name ends in .html")
    require_writable(output)
    file = policy_files(policy)[0].absolute()
    kept = load_policy(file)
    require_playable(kept.env_id)
    policies, title = {"policy": kept}, "A policy in your browser"
    if (file.parent / EVALUATED).is_dir():
        run = read_run(file.parent.parent)
        policies, title = _named_policies(run, file.parent), f"{run.title}, the policies of a run"
    if not alone and (shown := find_expert(policy, kept, expert)) is not None:
        policies["expert"] = shown
    html = play_html(policies, title=title, seed=seed, episode_length=policy_horizon(file))
    write_atomically(output, html)
    return list(policies)


def _named_policies(run: SavedRun, seed_directory: Path) -> dict[str, SavedPolicy]:
    """Return the stored policies by what the page calls them, the kept one first."""
    files, returns = stored_policies(run, seed_directory)
    policies: dict[str, SavedPolicy] = {}
    for iteration, path in reversed(files.items()):
        what = f"iteration {iteration}"
        if not policies:
            what = "kept policy"
        elif iteration == 0 and run.config["settings"].get("behavior_cloning_start"):
            what = "clone of the expert"
        share = percentage(returns[iteration], run.comparable_expert_return)
        result = f"{share} of the expert" if share else f"return {returns[iteration]:.0f}"
        policies[f"{what}: {result}"] = load_of(run, path)
    return policies


def stored_policies(run: SavedRun, seed_directory: Path) -> tuple[dict[int, Path], np.ndarray]:
    """Return the files of a seed's policies by iteration, the kept one last, and all returns.

    Raises:
        UserError: the run has no such seed or row, or has stored no policy but the kept one.
    """
    names = {f"seed_{seed}": seed for seed in run.kept_iterations}
    if seed_directory.name not in names:
        raise UserError(f"{seed_directory} is not of a seed that the run has kept a policy of")
    seed = names[seed_directory.name]
    kept = run.kept_iterations[seed]
    returns = run.of_seed(seed)["evaluation_return"]
    if kept >= len(returns):
        raise UserError(f"{run.directory / 'metrics.csv'} has no row of the kept iteration {kept}")
    earlier = sorted(iteration for iteration in MILESTONES if iteration < kept)
    files = {iteration: seed_directory / EVALUATED / f"{iteration}.npz" for iteration in earlier}
    files = {iteration: file for iteration, file in files.items() if file.is_file()}
    if not files and kept > 0:
        raise UserError(
            f"{seed_directory} has no {EVALUATED}/0.npz and so on: the run is of an earlier "
            "version, which stored only the kept policy; train it again"
        )
    return files | {kept: seed_directory / "policy.npz"}, returns


def choose(returns: Mapping[int, float]) -> list[int]:
    """Return the first iteration, the last, and the two that divide the way between them best.

    Their returns are the nearest to one third and two thirds of the way.
    """
    first, *between, last = returns if len(returns) > 1 else [*returns, *returns]
    chosen = {first, last}
    for share in (1 / 3, 2 / 3):
        goal = returns[first] + share * (returns[last] - returns[first])
        if between:
            nearest = min(between, key=lambda iteration: abs(returns[iteration] - goal))
            between.remove(nearest)
            chosen.add(nearest)
    return sorted(chosen)
