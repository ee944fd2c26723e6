"""What a page of ``ailsrs report`` is made of; ``page.html`` is its template."""

import dataclasses
import io
from collections.abc import Sequence
from importlib import resources

import jinja2
from matplotlib.figure import Figure

from ailsrs_jax.data.policies import SavedPolicy, expert_path, load_policy
from ailsrs_jax.data.sources import Source
from ailsrs_jax.envs.registry import require_harmless
from ailsrs_jax.errors import UserError
from ailsrs_jax.runs.storage.saved_run import SavedRun
from ailsrs_jax.show.renderer import require_renderer
from ailsrs_jax.show.replay import replay
from ailsrs_jax.show.sweep_report import Table
from ailsrs_jax.show.video import Animation, data_uri, require_encoder

SECONDS = 10.0  # of each episode that is shown
SCORES = (
    "Between the discriminator's scores of expert and policy is what it can tell them apart by: "
    "near one half the game is even, and where they part for 1 and 0 it has won, and has nothing "
    "to teach any more."
)
SIZES = {1: 480, 2: 480, 3: 360, 4: 320}  # of pictures [pixels], by how many there are


@dataclasses.dataclass(frozen=True)
class Tile:
    """A number that stands out."""

    label: str
    value: str
    note: str = ""


@dataclasses.dataclass(frozen=True)
class Media:
    """A video or a figure; without ``uri``, why there is none."""

    title: str
    uri: str | None
    caption: str


@dataclasses.dataclass(frozen=True)
class Page:
    """What the template shows, all of it text that is escaped there."""

    kind: str
    title: str
    subtitle: str
    tiles: Sequence[Tile]
    videos: Sequence[Media]
    figures: Sequence[Media]
    tables: Sequence[Table]
    note: str  # on the tables
    commands: Sequence[str]
    settings: Sequence[tuple[str, str, bool]]  # name, value, whether it is not the preset's
    versions: Sequence[tuple[str, str]]

    def html(self) -> str:
        """The page; it loads nothing, and forbids the browser to."""
        environment = jinja2.Environment(
            autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True
        )
        text = resources.files("ailsrs_jax.show").joinpath("page.html").read_text()
        return environment.from_string(text).render(vars(self))


def policies_of(run: SavedRun) -> dict[int, SavedPolicy]:
    """The kept policy of each seed that has one yet."""
    policies = {}
    for seed in run.config["seeds"]:
        path = run.directory / f"seed_{seed}" / "policy.npz"
        if path.is_file():
            policies[seed] = load_policy(path)
            if policies[seed].env_id != run.config["env_id"]:
                raise UserError(f"{path} is of {policies[seed].env_id}, not of the run's task")
    return policies


def expert_of(runs: Sequence[SavedRun]) -> SavedPolicy | None:
    """The shipped expert that they imitate, or could be compared with."""
    of_paper = any(run.source == Source("expert", "paper") for run in runs)
    try:
        return load_policy(expert_path(runs[0].config["env_id"], of_paper=of_paper))
    except UserError:
        return None


def play(
    title: str, policies: dict[str, SavedPolicy], expert: SavedPolicy | None, caption: str
) -> Media:
    """An episode of each, and of the expert, from the same initial state."""
    if expert is not None:
        policies = {"expert": expert} | policies
        caption += ", beside the shipped expert from the same initial state"
    try:
        require_encoder()
        require_renderer()
        for policy in policies.values():
            require_harmless(policy.env_id, title)
        replays = [replay(policy, seconds=SECONDS) for policy in policies.values()]
        address = Animation(replays, list(policies), SIZES[len(policies)]).data_uri
    except UserError as error:
        return Media(title, None, f"{error}.")
    return Media(title, address, f"{caption}.")


def svg(figure: Figure) -> str:
    """The figure as an address that holds it."""
    file = io.BytesIO()
    figure.savefig(file, format="svg", metadata={"Date": None})
    return data_uri("image/svg+xml", file.getvalue())


def millions(steps: float) -> str:
    """For people."""
    return f"{steps / 1e6:.2f} M"
