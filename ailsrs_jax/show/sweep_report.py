"""What a sweep leaves to be read: ``table.md``, ``timings.md`` and the figures."""

import math
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from rich.console import Console

from ailsrs_jax.files import write_atomically
from ailsrs_jax.sweeps.results import NOT_RUN, SweepResults, read_results
from ailsrs_jax.sweeps.statistics import (
    Estimate,
    Group,
    comparable,
    group_cells,
    interquartile_mean,
    mean_std,
    median_reached,
    scores,
)

EXPLANATION = """\
± is the standard deviation over seeds. *Return* is that of the kept policy in Gymnasium's own
environment, *last* that of the last iteration's policy, *over training* the mean over the
environment steps of training. Normalised: 0 random, 1 expert. *Steps to 90 %*: live environment
steps until an evaluation first reached 0.9 of the expert's return, the median over seeds, those
that never did counted as infinite; in brackets how many did."""


def report_sweep(directory: str | Path) -> None:
    """Write ``table.md``, ``timings.md`` and ``figures/`` from the tables in ``directory``.

    The first is a function of ``results.csv`` alone; what depends on the clock is in the second.
    Without matplotlib there are no figures, and a line that says so.

    Raises:
        UserError: a table cannot be read.
    """
    directory = Path(directory)
    results = read_results(directory)
    write_text(directory / "table.md", results_table(results))
    write_text(directory / "timings.md", timings_table(results))
    try:
        from ailsrs_jax.show.figures import draw_figures
    except ImportError:
        Console(stderr=True).print(
            "no figures: they need pip install 'ailsrs_jax[plot]'", markup=False
        )
        return
    draw_figures(results, directory / "figures")


def write_text(path: Path, text: str) -> None:
    """Write a text file, whole or not at all."""
    write_atomically(path, lambda file: file.write(text.encode()))


class Table(NamedTuple):
    """A table for people to read."""

    title: str
    header: list[str]
    rows: list[list[str]]
    note: str = ""


def results_table(results: SweepResults) -> str:
    """Markdown: the interquartile means over all tasks, a table per task, what failed."""
    parts = [EXPLANATION]
    for table in result_tables(results):
        parts += markdown_section(table)
    return "\n\n".join(parts) + "\n"


def result_tables(results: SweepResults) -> list[Table]:
    """The interquartile means over all tasks, a table per task, what failed."""
    groups = group_cells(results.cells)
    tables = [*_aggregate_tables(groups)]
    header = ["", "demonstrations", "seeds", "return", "expert", "normalised", "last"]
    header += ["over training, normalised", "steps to 90 %"]
    for task in dict.fromkeys(group.env_id for group in groups):
        rows = [
            [
                group.series,
                _count(group),
                f"{len(group.cells)} of {group.num_planned}",
                plus_minus(group.values("return_mean")),
                mean(group.values("expert_return")),
                plus_minus(group.values("normalized"), 2),
                plus_minus(group.values("last_return")),
                plus_minus(group.values("normalized_over_training"), 2),
                _reached(group, group.values("steps_to_90"), lambda n: f"{n / 1e6:.2f} M"),
            ]
            for group in groups
            if group.env_id == task
        ]
        tables.append(Table(task, header, rows))
    ended = [cell for cell in results.cells if cell.status != NOT_RUN]
    if failed := [[cell.cell, cell.status] for cell in ended if not cell.done]:
        tables.append(Table("Failed", ["cell", "status"], failed))
    if len(ended) < len(results.cells):
        missing = f"{len(results.cells) - len(ended)} of {len(results.cells)} cells"
        tables.append(Table("Not run", ["not finished"], [[missing]]))
    return tables


def aggregates(groups: Sequence[Group], level: int = 2) -> list[str]:
    """Markdown: the interquartile means over all tasks, below a heading of that level."""
    return [part for table in _aggregate_tables(groups) for part in markdown_section(table, level)]


def _aggregate_tables(groups: Sequence[Group]) -> list[Table]:
    """The interquartile means over all tasks, where they can be compared."""
    common = comparable(groups)
    if not common or not all(common.values()):
        return []
    rows = [
        [
            series,
            f"{sum(len(group.cells) for group in mine)} of "
            f"{sum(group.num_planned for group in mine)}",
            *(
                estimate(interquartile_mean(strata)) if strata else "–"
                for strata in (scores(mine), scores(mine, "normalized_over_training"))
            ),
        ]
        for series, mine in common.items()
    ]
    conditions = {group.condition for mine in common.values() for group in mine}
    plural = "s" * (len(conditions) > 1)
    title = f"Interquartile means over {len(conditions)} condition{plural}"
    note = (
        "Normalised returns, with the 95 % interval of a stratified bootstrap over seeds. A "
        "condition is a\ntask and a number of demonstrations; these are the ones that all have "
        "been measured under."
    )
    return [Table(title, ["", "runs", "kept policy", "over training"], rows, note)]


def timings_table(results: SweepResults) -> str:
    """Markdown: a table of what depends on the machine and on what else it did."""
    rows = []
    for group in group_cells(results.cells):
        timings = [
            results.timings[cell.cell] for cell in group.cells if cell.cell in results.timings
        ]
        if timings:
            columns = np.array(
                [(t.train_seconds, t.compile_seconds, t.seconds_to_90_percent) for t in timings]
            ).T
            train, compilation = (f"{np.median(column):.0f} s" for column in columns[:2])
            rows.append(
                [
                    group.series,
                    group.env_id,
                    _count(group),
                    _reached(group, columns[2], lambda seconds: f"{seconds:.0f} s"),
                    train,
                    compilation,
                    " and ".join(dict.fromkeys(timing.hardware for timing in timings)),
                ]
            )
    header = ["", "task", "demonstrations", "to 90 % of the expert", "training", "compilation"]
    note = "Wall-clock time of a seed, the median over seeds; in brackets how many reached it."
    return f"{note}\n\n{markdown_table([*header, 'hardware'], rows)}\n"


def markdown_section(table: Table, level: int = 2) -> list[str]:
    """Heading, note and table."""
    parts = [f"{'#' * level} {table.title}", table.note, markdown_table(table.header, table.rows)]
    return [part for part in parts if part]


def markdown_table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table; bars in its fields are escaped."""
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join(
        "| " + " | ".join(field.replace("|", "\\|") for field in line) + " |" for line in lines
    )


def plus_minus(values: np.ndarray, decimals: int = 0) -> str:
    """Mean ± standard deviation over seeds."""
    center, spread = mean_std(values)
    if math.isnan(center):
        return "–"
    return f"{center:z.{decimals}f}" + ("" if math.isnan(spread) else f" ± {spread:.{decimals}f}")


def mean(values: np.ndarray) -> str:
    """Mean over seeds."""
    return "–" if np.isnan(values).any() else f"{values.mean():.0f}"


def estimate(value: Estimate) -> str:
    """The value, and its interval where there is one."""
    interval = "" if math.isnan(value.low) else f" [{value.low:z.2f}, {value.high:z.2f}]"
    return f"{value.value:z.2f}{interval}"


def _reached(group: Group, values: np.ndarray, show: Callable[[float], str]) -> str:
    if not group.has_comparable_curves:
        return "–"
    median, reached = median_reached(values)
    return f"{show(median) if math.isfinite(median) else '–'} ({reached} of {len(values)})"


def _count(group: Group) -> str:
    return "–" if group.num_trajectories is None else str(group.num_trajectories)
