"""The page of ``ailsrs compare``."""

from collections.abc import Mapping, Sequence

from ailsrs_jax.runs.storage.saved_run import SavedRun
from ailsrs_jax.show.curves import PANELS, STEPS, by_seed
from ailsrs_jax.show.reports.charts import Chart, Line, Panel, colors_of
from ailsrs_jax.show.reports.page import Page
from ailsrs_jax.show.sweep_report import Table
from ailsrs_jax.trainers.parts.reference import CLOSE

COMPARED = ("evaluation_return", "expert_distance")


def comparison_page(
    runs: Mapping[str, SavedRun], header: Sequence[str], rows: Sequence[Sequence[str]], note: str
) -> Page:
    """Return the page of ``runs`` of one task, by name: a table, and their curves on common axes.

    The table has a row for each run, and ``note`` says what its columns mean.
    """
    colors = colors_of(runs)
    experts = [e for run in runs.values() if (e := run.comparable_expert_return) is not None]
    levels = {
        "evaluation_return": {"expert": max(experts)} if experts else {},
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
            panels.append(Panel("", STEPS, label, lines, levels[column], limits or (None, None)))
    (task,) = {run.config["env_id"] for run in runs.values()}
    return Page(
        kind="comparison",
        title=f"Runs of {task}",
        subtitle=f"{len(runs)} run{'s' * (len(runs) > 1)}",
        parts=[
            Table("Runs", list(header), [list(row) for row in rows]),
            Chart("Training", panels, colors, "A line is a seed."),
        ],
        note=note,
        commands=[command for run in runs.values() if (command := run.command)],
    )
