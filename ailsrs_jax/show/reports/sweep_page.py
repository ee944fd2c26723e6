"""The page of a sweep."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from matplotlib import style

from ailsrs_jax.runs.storage.saved_run import SavedRun, read_run
from ailsrs_jax.show.curves import draw_discriminators
from ailsrs_jax.show.figures import draw_figures
from ailsrs_jax.show.reports.page import (
    SCORES,
    Media,
    Page,
    Tile,
    embedded,
    millions,
    play,
    policies_of,
)
from ailsrs_jax.show.style import STYLE
from ailsrs_jax.show.sweep_report import EXPLANATION, result_tables
from ailsrs_jax.show.video import shipped_expert
from ailsrs_jax.sweeps.results import SweepResults, read_results
from ailsrs_jax.sweeps.statistics import Group, group_cells

MOST_SHOWN = 4  # pictures of a video: the expert and the first three series
TITLES = {  # of figures, by how their names begin
    "figure_2": "Return against the number of demonstrations",
    "figure_3": "Training curves",
    "scores": "Normalised returns",
    "profiles": "Performance profiles",
}

Runs = Mapping[str, SavedRun]  # by the name of their cell


def sweep_page(directory: Path, *, video: bool = True) -> Page:
    """Return the page of a sweep.

    Raises:
        UserError: a table or a cell's run is damaged.
    """
    results = read_results(directory)
    groups = group_cells(results.cells)
    series = dict.fromkeys(group.series for group in groups)
    # A cell's name becomes no path: directories that exist are looked up by their names.
    there = {path.name: path for path in directory.glob("cells/*") if path.is_dir()}
    runs = {cell.cell: read_run(there[cell.cell]) for cell in results.done if cell.cell in there}
    versions = next(iter(runs.values())).config["versions"] if runs else {}
    return Page(
        kind="sweep",
        title=directory.resolve().name,
        subtitle=" · ".join(series),
        tiles=[
            Tile("runs finished", str(len(results.done)), f"of {len(results.cells)}"),
            Tile("tasks", str(len({cell.env_id for cell in results.done}))),
            Tile("series", str(len(series))),
            Tile("seeds", str(len({cell.seed for cell in results.done}))),
            Tile(
                "environment steps",
                millions(sum(cell.env_steps for cell in results.done)),
                "live steps of all runs",
            ),
        ],
        videos=_videos(groups, runs) if video else [],
        figures=[*_figures(results), *_discriminators(groups, runs)],
        tables=result_tables(results),
        note=EXPLANATION.replace("*", ""),
        commands=[command for run in runs.values() if (command := run.command)],
        settings=[],
        versions=[(name, str(version)) for name, version in versions.items()],
    )


def _videos(groups: Sequence[Group], runs: Runs) -> list[Media]:
    """Show on each task one run per series: the first seed with the most demonstrations."""
    if not runs:
        return [Media("Policies", None, "There are no runs beside these tables to show.")]
    videos = []
    for task in dict.fromkeys(group.env_id for group in groups):
        shown: dict[str, SavedRun] = {}
        for group in sorted(groups, key=lambda group: group.num_trajectories or 0):
            saved = [cell for cell in group.cells if cell.cell in runs]
            if group.env_id == task and saved:
                shown[group.series] = runs[min(saved, key=lambda cell: cell.seed).cell]
        first = [group.series for group in groups if group.series in shown]
        policies = {
            series: policy
            for series in list(dict.fromkeys(first))[: MOST_SHOWN - 1]
            for policy in policies_of(shown[series]).values()
        }
        if policies:
            expert = shipped_expert(task, *(run.source for run in shown.values()))
            caption = "The first seed of each, with the most demonstrations, in real time"
            videos.append(play(task, policies, expert, caption, next(iter(shown.values()))))
    return videos


def _figures(results: SweepResults) -> list[Media]:
    drawn = draw_figures(results)
    with style.context(STYLE):
        return [
            Media(title, embedded(figure, "png"))
            for begin, title in TITLES.items()
            for name, figure in drawn.items()
            if name.startswith(begin)
        ]


def _discriminators(groups: Sequence[Group], runs: Runs) -> list[Media]:
    """Show the discriminator's scores of all runs that have one."""
    tasks: dict[str, list[tuple[str, SavedRun]]] = {}
    for group in groups:
        for cell in group.cells:
            if cell.cell in runs and "policy_score" in runs[cell.cell].metrics:
                tasks.setdefault(group.env_id, []).append((group.series, runs[cell.cell]))
    if not tasks:
        return []
    return [Media("Discriminator's scores", embedded(draw_discriminators(tasks), "svg"), SCORES)]
