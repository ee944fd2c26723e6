"""The report of a sweep: ``table.md``, ``timings.md`` and the figures."""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ailsrs_jax.files import write_atomically
from ailsrs_jax.runs.storage.metrics import share_of
from ailsrs_jax.show.figures import save_figures, split
from ailsrs_jax.show.model_card import escape_markdown
from ailsrs_jax.sweeps.results import NOT_RUN, Curve, SweepResults, read_results
from ailsrs_jax.sweeps.statistics import (
    Estimate,
    Group,
    comparable,
    group_cells,
    interquartile_mean,
    mean_std,
    median_reached,
    probability_of_improvement,
    scores,
    shared_conditions,
    shared_scores,
)

EXPLANATION = """\
± is the standard deviation over seeds. *Return* is that of the kept policy in Gymnasium's own
environment, *last* that of the last iteration's policy, *over training* the mean over the
environment steps of training. Normalised returns are 0 for random actions and 1 for the expert."""
COMPARED = """\
Normalised returns with the 95 % interval of a stratified bootstrap over seeds. A condition is a
task and a number of demonstrations; all series were measured under the conditions of this table.
An interquartile mean is the mean of the middle half of all runs together. With fewer than four
runs it is the mean of all."""
IMPROVED = """\
The probability that a run of the series in the title has a higher normalised return than a run of
the series in the row: the share of all pairs of runs, as a mean over the conditions that the two
share, with the 95 % interval of a stratified bootstrap over seeds. A tie counts half."""
REACHED = """\
Live environment steps until an evaluation first returned this share of the expert's return: the
median over seeds, where a seed that never did counts as infinite. Brackets: how many seeds did."""
TIMED = "Wall-clock time of one seed: the median over seeds. Brackets: how many seeds reached it."

SHARES = (0.5, 0.9, 0.95)  # of the expert's return


class Table(NamedTuple):
    """A table for people."""

    title: str
    header: Sequence[str]
    rows: Sequence[Sequence[str]]
    note: str = ""


def report_sweep(directory: str | Path) -> None:
    """Write ``table.md``, ``timings.md`` and ``figures/`` from the tables in ``directory``.

    Everything that depends on the clock is in ``timings.md``.

    Raises:
        UserError: a table cannot be read.
    """
    directory = Path(directory)
    results = read_results(directory)
    write_atomically(directory / "table.md", results_table(results))
    write_atomically(directory / "timings.md", timings_table(results))
    save_figures(results, directory / "figures")


def results_table(results: SweepResults) -> str:
    """Return the tables of results as Markdown."""
    sections = (part for table in result_tables(results) for part in markdown_section(table))
    return "\n\n".join([EXPLANATION, *sections]) + "\n"


def result_tables(results: SweepResults) -> list[Table]:
    """Return the tables that compare series, a table per task, and what failed or did not run."""
    groups = group_cells(results.cells)
    tables = aggregate_tables(groups)
    for task, mine in split(groups, "env_id").items():
        rows = [[show(group) for show in COLUMNS.values()] for group in mine]
        tables.append(Table(task, list(COLUMNS), rows))
    tables += _costs(groups, results.curves)
    ended = [cell for cell in results.cells if cell.status != NOT_RUN]
    if failed := [[cell.cell, cell.status] for cell in ended if not cell.done]:
        tables.append(Table("Failed", ["cell", "status"], failed))
    if len(ended) < len(results.cells):
        missing = f"{len(results.cells) - len(ended)} of {len(results.cells)} cells"
        tables.append(Table("Not run", ["not finished"], [[missing]]))
    return tables


def aggregate_tables(groups: Sequence[Group]) -> list[Table]:
    """Return the tables that compare series over all tasks, where they can be compared."""
    return [*_interquartile_means(groups), *_improvements(groups)]


def _interquartile_means(groups: Sequence[Group]) -> list[Table]:
    common = comparable(groups)
    if len(common) < 2 or not all(common.values()):  # of one series, each task says more
        return []
    rows = []
    for series, mine in common.items():
        done = sum(len(group.cells) for group in mine)
        measured = (scores(mine), scores(mine, "normalized_over_training"))
        means = [estimate(interquartile_mean(strata)) if strata else "–" for strata in measured]
        rows.append([series, f"{done} of {sum(group.num_planned for group in mine)}", *means])
    shared = shared_conditions(groups)
    title = f"Interquartile means over {len(shared)} conditions"
    if len(shared) == 1:
        ((task, number),) = shared
        title = f"Interquartile means on {task}" + (f" from {number}" if number else "")
    return [Table(title, ["", "runs", "kept policy", "over training"], rows, COMPARED)]


def _improvements(groups: Sequence[Group]) -> list[Table]:
    """Compare the first series of AILSRS with each other one; without AILSRS, the first of all."""
    ordered = sorted(groups, key=lambda group: group.cells[0].algorithm != "ailsrs")
    (first, mine), *others = split(ordered, "series").items() or [("", [])]
    rows = [
        [series, str(len(pairs)), estimate(probability_of_improvement(pairs))]
        for series, theirs in others
        if (pairs := shared_scores(mine, theirs))
    ]
    title = f"Probability that {first} scores higher"
    return [Table(title, ["than", "conditions", "probability"], rows, IMPROVED)] if rows else []


def _costs(groups: Iterable[Group], curves: Mapping[str, Curve]) -> list[Table]:
    rows = []
    for group in groups:
        drawn = [cell for cell in group.cells if cell.cell in curves]
        if not (group.has_comparable_curves and drawn and math.isfinite(drawn[0].expert_return)):
            continue
        reached = []
        for share in SHARES:
            levels = (share_of(cell.expert_return, share) for cell in drawn)
            steps = [curves[cell.cell].steps_to(level) for cell, level in zip(drawn, levels)]
            reached.append(_reached(np.array(steps) / 1e6, "{:.2f} M"))
        rows.append([group.series, group.env_id, _count(group), *reached])
    header = ["", "task", "demonstrations", *(f"to {100 * share:.0f} %" for share in SHARES)]
    return [Table("Environment steps to the expert's level", header, rows, REACHED)] if rows else []


def timings_table(results: SweepResults) -> str:
    """Return as Markdown a table of everything that depends on the machine and on its load."""
    header = ["", "task", "demonstrations", "to 90 % of the expert", "training", "compilation"]
    rows = []
    for group in group_cells(results.cells):
        cells = [cell.cell for cell in group.cells if cell.cell in results.timings]
        if timed := [results.timings[cell] for cell in cells]:
            to_90 = np.array([timing.seconds_to_90_percent for timing in timed])
            reached = _reached(to_90, "{:.0f} s") if group.has_comparable_curves else "–"
            seconds = [(timing.train_seconds, timing.compile_seconds) for timing in timed]
            medians = [f"{median:.0f} s" for median in np.median(seconds, axis=0)]
            hardware = " and ".join(dict.fromkeys(timing.hardware for timing in timed))
            rows.append([group.series, group.env_id, _count(group), reached, *medians, hardware])
    return f"{TIMED}\n\n{markdown_table([*header, 'hardware'], _escaped(rows))}\n"


def markdown_section(table: Table, level: int = 2) -> list[str]:
    """Return the heading, the note and the table."""
    title, rows = escape_markdown(table.title), _escaped(table.rows)
    parts = [f"{'#' * level} {title}", table.note, markdown_table(table.header, rows)]
    return [part for part in parts if part]


def markdown_table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a Markdown table, whose fields are Markdown."""
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _escaped(rows: Iterable[Sequence[str]]) -> list[list[str]]:
    """Escape what a stranger's tables may hold, such as labels."""
    return [[escape_markdown(field) for field in row] for row in rows]


def plus_minus(values: np.ndarray, decimals: int = 0) -> str:
    """Return mean ± standard deviation over seeds."""
    center, spread = mean_std(values)
    if math.isnan(center):
        return "–"
    return f"{center:z.{decimals}f}" + ("" if math.isnan(spread) else f" ± {spread:.{decimals}f}")


def estimate(value: Estimate) -> str:
    """Return the value, with its interval if it has one."""
    interval = "" if math.isnan(value.low) else f" [{value.low:z.2f}, {value.high:z.2f}]"
    return f"{value.value:z.2f}{interval}"


def _mean(values: np.ndarray) -> str:
    return "–" if np.isnan(values).any() else f"{values.mean():.0f}"


def _reached(values: np.ndarray, form: str) -> str:
    median, reached = median_reached(values)
    return f"{form.format(median) if math.isfinite(median) else '–'} ({reached} of {len(values)})"


def _count(group: Group) -> str:
    return "–" if group.num_trajectories is None else str(group.num_trajectories)


COLUMNS: dict[str, Callable[[Group], str]] = {  # of the table of a task
    "": lambda group: group.series,
    "demonstrations": _count,
    "seeds": lambda group: f"{len(group.cells)} of {group.num_planned}",
    "return": lambda group: plus_minus(group.values("return_mean")),
    "expert": lambda group: _mean(group.values("expert_return")),
    "normalised": lambda group: plus_minus(group.values("normalized"), 2),
    "last": lambda group: plus_minus(group.values("last_return")),
    "over training, normalised": lambda group: plus_minus(
        group.values("normalized_over_training"), 2
    ),
}
