"""The content of a page of ``ailsrs report``; ``page.html`` is its template."""

import base64
import dataclasses
import hashlib
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

import markupsafe

from ailsrs_jax.data.policies import SavedPolicy
from ailsrs_jax.errors import UserError
from ailsrs_jax.runs.horizon import saved_horizon
from ailsrs_jax.runs.storage.saved_run import SavedRun
from ailsrs_jax.show.episodes.frames import Watch
from ailsrs_jax.show.episodes.play import TEMPLATES
from ailsrs_jax.show.episodes.renderer import require_renderer
from ailsrs_jax.show.episodes.replay import replay
from ailsrs_jax.show.reports.charts import Chart
from ailsrs_jax.show.reports.weights import WeightMaps
from ailsrs_jax.show.sweep_report import Table
from ailsrs_jax.show.video import Animation, load_of, shipped_expert

SECONDS = 10.0  # of each episode that is shown
SIZES = {1: 480, 2: 480, 3: 360, 4: 320}  # of pictures [pixels], by the number of pictures


@dataclasses.dataclass(frozen=True)
class Tile:
    """A number that stands out."""

    label: str
    value: str
    note: str = ""


@dataclasses.dataclass(frozen=True)
class Media:
    """A video or a figure; without a ``uri`` the caption says why there is none."""

    title: str
    uri: str | None
    caption: str = ""


Part = Chart | Table | WeightMaps | Media | None


@dataclasses.dataclass(frozen=True, kw_only=True)
class Page:
    """Everything that the template shows; the template makes text of it, and escapes it."""

    kind: str
    title: str
    subtitle: str
    tiles: Sequence[Tile] = ()  # the first is the answer, and the largest
    parts: Sequence[Part]  # None shows nothing
    note: str = ""  # on the tables
    commands: Sequence[str]
    settings: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    changed: Collection[str] = ()  # settings that differ from the preset
    versions: Mapping[str, Any] = dataclasses.field(default_factory=dict)

    def html(self) -> str:
        """Return the page. It loads nothing, and the browser may run no script but its own."""
        script = Path(__file__).with_name("page.js").read_text()
        digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
        own = {"script": markupsafe.Markup(script), "script_hash": f"sha256-{digest}"}
        return TEMPLATES.get_template("reports/page.html").render(vars(self) | own)


def policies_of(run: SavedRun) -> dict[int, SavedPolicy]:
    """Load the kept policy of each seed that has saved one."""
    paths = {seed: run.directory / f"seed_{seed}" / "policy.npz" for seed in run.config["seeds"]}
    return {seed: load_of(run, path) for seed, path in paths.items() if path.is_file()}


def play(
    title: str,
    policies: Mapping[str, SavedPolicy],
    runs: Sequence[SavedRun],
    caption: str,
    watch: Watch,
) -> Media:
    """Render an episode of each policy of ``runs``, and of the shipped expert if there is one.

    Episodes are as long as those of the first run.
    """
    run = runs[0]
    expert = shipped_expert(run.config["env_id"], *(each.source for each in runs))
    if expert is not None:
        policies = {"expert": expert, **policies}
        caption += ", beside the shipped expert from the same initial state"
    try:
        require_renderer()
        length = saved_horizon(run.config, run.directory)
        replays = [
            replay(policy, seconds=SECONDS, episode_length=length) for policy in policies.values()
        ]
        uri = Animation(replays, list(policies), SIZES[len(policies)], watch).data_uri
    except UserError as error:
        return Media(title, None, f"{error}.")
    return Media(title, uri, f"{caption}.")


def millions(steps: float) -> str:
    """Return a number of steps in millions, for people."""
    return f"{steps / 1e6:.2f} M"
