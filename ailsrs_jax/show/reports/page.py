"""The content of a page of ``ailsrs report``; ``page.html`` is its template."""

import base64
import dataclasses
import hashlib
from collections.abc import Sequence

import jinja2
import markupsafe
from matplotlib.figure import Figure

from ailsrs_jax.data.policies import SavedPolicy, load_policy
from ailsrs_jax.errors import UserError
from ailsrs_jax.runs.horizon import saved_horizon
from ailsrs_jax.runs.storage.saved_run import SavedRun
from ailsrs_jax.show.episodes.frames import Watch
from ailsrs_jax.show.episodes.renderer import require_renderer
from ailsrs_jax.show.episodes.replay import replay
from ailsrs_jax.show.reports.charts import Chart
from ailsrs_jax.show.reports.weights import WeightMaps
from ailsrs_jax.show.style import encoded
from ailsrs_jax.show.sweep_report import Table
from ailsrs_jax.show.video import Animation, data_uri

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


Part = Chart | Table | WeightMaps | Media


@dataclasses.dataclass(frozen=True, kw_only=True)
class Page:
    """Everything that the template shows, as text; the template escapes it."""

    kind: str
    title: str
    subtitle: str
    tiles: Sequence[Tile] = ()  # the first is the answer, and the largest
    parts: Sequence[Part]
    note: str = ""  # on the tables
    commands: Sequence[str]
    # name, value, whether it differs from the preset
    settings: Sequence[tuple[str, str, bool]] = ()
    versions: Sequence[tuple[str, str]] = ()

    def html(self) -> str:
        """Return the page. It loads nothing, and the browser may run no script but its own."""
        loader = jinja2.PackageLoader("ailsrs_jax", "show/reports")
        environment = jinja2.Environment(
            loader=loader,
            autoescape=True,
            undefined=jinja2.StrictUndefined,
            trim_blocks=True,
            lstrip_blocks=True,
        )
        script, *_ = loader.get_source(environment, "page.js")
        digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
        own = {"script": markupsafe.Markup(script), "script_hash": f"sha256-{digest}"}
        return environment.get_template("page.html").render(vars(self) | own)


def policies_of(run: SavedRun) -> dict[int, SavedPolicy]:
    """Load the kept policy of each seed that has saved one."""
    policies = {}
    for seed in run.config["seeds"]:
        path = run.directory / f"seed_{seed}" / "policy.npz"
        if path.is_file():
            policies[seed] = load_policy(path)
            if policies[seed].env_id != run.config["env_id"]:
                raise UserError(f"{path} is of {policies[seed].env_id}, not of the run's task")
    return policies


def play(
    title: str,
    policies: dict[str, SavedPolicy],
    expert: SavedPolicy | None,
    caption: str,
    run: SavedRun,
    watch: Watch,
) -> Media:
    """Render an episode of each policy and of the expert, as long as those of ``run``."""
    if expert is not None:
        policies = {"expert": expert} | policies
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


def embedded(figure: Figure) -> str:
    """Return the figure as the data address of a PNG."""
    return data_uri("image/png", encoded(figure, "png"))


def millions(steps: float) -> str:
    """Return a number of steps in millions, for people."""
    return f"{steps / 1e6:.2f} M"
