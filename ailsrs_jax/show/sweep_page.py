"""The page of a sweep."""

import tempfile
from collections.abc import Sequence
from pathlib import Path

from ailsrs_jax.runs.storage.saved_run import SavedRun, read_run
from ailsrs_jax.show.curves import draw_discriminators
from ailsrs_jax.show.figures import draw_figures
from ailsrs_jax.show.page import (
    SCORES,
    Media,
    Page,
    Tile,
    expert_of,
    millions,
    play,
    policies_of,
    svg,
)
from ailsrs_jax.show.sweep_report import EXPLANATION, result_tables
from ailsrs_jax.show.video import data_uri
from ailsrs_jax.sweeps.results import CellResult, SweepResults, read_results
from ailsrs_jax.sweeps.statistics import Group, group_cells

MOST_SHOWN = 4  # pictures of a video: the expert's, and as many series as fit


def sweep_page(directory: Path, *, video: bool = True) -> Page:
    """The page of a sweep.

    Raises:
        UserError: a table or a cell's run is damaged.
    """
    results = read_results(directory)
    groups = group_cells(results.cells)
    runs = _runs(directory, results) if results.done else {}
    steps = sum(cell.env_steps for cell in results.done)
    counts = {
        "tasks": len({cell.env_id for cell in results.done}),
        "series": len({group.series for group in groups}),
        "seeds": len({cell.seed for cell in results.done}),
    }
    first = next(iter(runs.values()), None)
    return Page(
        kind="sweep",
        title=directory.resolve().name,
        subtitle=" · ".join(dict.fromkeys(group.series for group in groups)),
        tiles=[
            Tile("runs finished", str(len(results.done)), f"of {len(results.cells)}"),
            *(Tile(label, str(count)) for label, count in counts.items()),
            Tile("environment steps", millions(steps), "live ones, of all runs"),
        ],
        videos=_sweep_videos(groups, runs) if video else [],
        figures=[*_figures(results), *_discriminators(groups, runs)],
        tables=result_tables(results),
        note=EXPLANATION.replace("*", ""),
        commands=[command for run in runs.values() if (command := run.command)],
        settings=[],
        versions=[(name, str(v)) for name, v in first.config["versions"].items()] if first else [],
    )


def _runs(directory: Path, results: SweepResults) -> dict[str, SavedRun]:
    """The finished runs that are there, by cell; of committed results none are."""
    # Looked for among what is there: a name in a table is never a path.
    there = {path.name: path for path in directory.glob("cells/*") if path.is_dir()}
    return {cell.cell: read_run(there[cell.cell]) for cell in results.done if cell.cell in there}


def _sweep_videos(groups: Sequence[Group], runs: dict[str, SavedRun]) -> list[Media]:
    """Of each task the first seed of each of the first series, with the most demonstrations."""
    if not runs:
        return [Media("Policies", None, "No runs are beside these tables, so no policies either.")]
    videos = []
    for task in dict.fromkeys(group.env_id for group in groups):
        cells: dict[str, list[CellResult]] = {}
        for group in groups:
            there = [cell for cell in group.cells if cell.env_id == task and cell.cell in runs]
            if there:
                cells.setdefault(group.series, []).extend(there)
        shown = {
            series: runs[max(mine, key=lambda cell: (cell.num_trajectories or 0, -cell.seed)).cell]
            for series, mine in list(cells.items())[: MOST_SHOWN - 1]
        }
        policies = {
            label: policy for label, run in shown.items() for policy in policies_of(run).values()
        }
        caption = "The first seed of each, with the most demonstrations, in real time"
        if policies:
            videos.append(play(task, policies, expert_of(list(shown.values())), caption))
    return videos


def _discriminators(groups: Sequence[Group], runs: dict[str, SavedRun]) -> list[Media]:
    """The scores in all runs that have one, if any has."""
    tasks: dict[str, list[tuple[str, SavedRun]]] = {}
    for group in groups:
        for cell in group.cells:
            if cell.cell in runs and "policy_score" in runs[cell.cell].metrics:
                tasks.setdefault(group.env_id, []).append((group.series, runs[cell.cell]))
    if not tasks:
        return []
    return [Media("Discriminator's scores", svg(draw_discriminators(tasks)), SCORES)]


def _figures(results: SweepResults) -> list[Media]:
    titles = {
        "figure_2": "Return against the number of demonstrations",
        "figure_3": "Training curves",
        "scores": "Normalised returns",
        "profiles": "Performance profiles",
    }
    with tempfile.TemporaryDirectory() as folder:
        draw_figures(results, Path(folder))
        drawn = {path.stem: path.read_bytes() for path in sorted(Path(folder).glob("*.png"))}
    return [
        Media(title, data_uri("image/png", content), "")
        for name, title in titles.items()
        for stem, content in drawn.items()
        if stem.startswith(name)
    ]
