"""The pages of many runs: that of a sweep, and that of ``ailsrs compare``."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from matplotlib import style

from ailsrs_jax.runs.storage.saved_run import SavedRun, read_run
from ailsrs_jax.show.curves import PANELS, STEPS, by_seed
from ailsrs_jax.show.episodes.frames import Watch, unwatched
from ailsrs_jax.show.figures import (
    draw_profiles,
    draw_scores,
    looks_of,
    most_demonstrated,
    split,
)
from ailsrs_jax.show.reports.charts import Chart, Line, Panel, colors_of
from ailsrs_jax.show.reports.curves import draw_discriminators, draw_numbers, draw_series, seeds
from ailsrs_jax.show.reports.page import Media, Page, Part, millions, play, policies_of
from ailsrs_jax.show.style import STYLE, encoded
from ailsrs_jax.show.sweep_report import EXPLANATION, Table, result_tables
from ailsrs_jax.show.video import data_uri
from ailsrs_jax.sweeps.results import SweepResults, read_results
from ailsrs_jax.sweeps.statistics import Group, group_cells
from ailsrs_jax.trainers.parts.reference import CLOSE

MOST_SHOWN = 4  # pictures of a video: the expert and the first three series
COMPARED = ("evaluation_return", "expert_distance")


def sweep_page(directory: Path, *, video: bool = True, watch: Watch = unwatched) -> Page:
    """Return the page of a sweep.

    Raises:
        UserError: a table or a cell's run is damaged.
    """
    results = read_results(directory)
    groups = group_cells(results.cells)
    colors = colors_of(group.series for group in groups)
    # A cell's name becomes no path: directories that exist are looked up by their names.
    there = {path.name: path for path in directory.glob("cells/*") if path.is_dir()}
    runs = {cell.cell: read_run(there[cell.cell]) for cell in results.done if cell.cell in there}
    tables = result_tables(results)
    parts: list[Part] = [
        *tables[:1],
        draw_series(groups, results, colors),
        *tables[1:],
        draw_numbers(groups, colors),
        *_figures(groups),
        draw_discriminators(groups, runs, colors),
        *(_videos(groups, runs, watch) if video else []),
    ]
    return Page(
        kind="sweep",
        title=directory.resolve().name,
        subtitle=_facts(results, groups),
        parts=parts,
        note=EXPLANATION.replace("*", ""),
        commands=[command for run in runs.values() if (command := run.command)],
        versions=next((run.config["versions"] for run in runs.values()), {}),
    )


def _facts(results: SweepResults, groups: Sequence[Group]) -> str:
    facts = [f"{len(results.done)} of {len(results.cells)} runs finished"]
    if groups:
        number = len({group.env_id for group in groups})
        steps = millions(sum(cell.env_steps for cell in results.done))
        facts += [
            f"{number} task{'s' * (number > 1)}",
            f"{seeds(*(len(group.cells) for group in groups))} each",
            f"{steps} live steps",
        ]
    return " · ".join(facts)


def _videos(groups: Sequence[Group], runs: Mapping[str, SavedRun], watch: Watch) -> list[Media]:
    """Show on each task one run per series: the first seed with the most demonstrations.

    The ``runs`` are by the name of their cell.
    """
    if not runs:
        return [Media("Policies", None, "There are no runs beside these tables to show.")]
    videos = []
    for task, mine in split(groups, "env_id").items():
        shown = {group.series: its[0] for group, its in most_demonstrated(mine, runs)}
        series = [name for name in split(groups, "series") if name in shown]
        policies = {
            name: policy
            for name in series[: MOST_SHOWN - 1]
            for policy in policies_of(shown[name]).values()
        }
        if policies:
            caption = "The first seed of each, with the most demonstrations, in real time"
            videos.append(play(task, policies, list(shown.values()), caption, watch))
    return videos


def _figures(groups: Sequence[Group]) -> list[Media]:
    looks = looks_of(groups)
    with style.context(STYLE):
        drawn = {
            "Normalised returns": draw_scores(groups, looks),
            "Performance profiles": draw_profiles(groups, looks),
        }
        return [
            Media(title, data_uri("image/png", encoded(figure, "png")))
            for title, figure in drawn.items()
            if figure
        ]


def comparison_page(
    runs: Mapping[str, SavedRun], header: Sequence[str], rows: Sequence[Sequence[str]], note: str
) -> Page:
    """Return the page of ``runs`` of one task, by name: a table, and their curves on common axes.

    The table has a row for each run, and ``note`` says what its columns mean.
    """
    colors = colors_of(runs)
    experts: dict[float, list[str]] = {}
    for name, run in runs.items():
        if (expert := run.comparable_expert_return) is not None:
            experts.setdefault(expert, []).append(name)
    levels = {
        "evaluation_return": {
            "expert" if len(experts) == 1 else f"expert of {', '.join(names)}": expert
            for expert, names in experts.items()
        },
        "expert_distance": {"close to the expert": CLOSE},
    }
    panels = []
    for column in COMPARED:
        label, limits = PANELS[column]
        lines = [
            Line(name, mine["env_steps"] / 1e6, mine[column])
            for name, run in runs.items()
            if column in run.metrics
            for mine in by_seed(run).values()
        ]
        if lines:
            panels.append(Panel("", STEPS, label, lines, levels[column], limits))
    (task,) = {run.config["env_id"] for run in runs.values()}
    return Page(
        kind="comparison",
        title=f"Runs of {task}",
        subtitle=f"{len(runs)} run{'s' * (len(runs) > 1)}",
        parts=[
            Table("Runs", header, rows),
            Chart("Training", panels, colors, "A line is a seed."),
        ],
        note=note,
        commands=[command for run in runs.values() if (command := run.command)],
    )
