"""The curves of a page: those of a run, and those of a sweep with one colour for each series."""

from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from ailsrs_jax.runs.storage.saved_run import SavedRun
from ailsrs_jax.show.curves import EVEN, PANELS, STEPS, by_seed
from ailsrs_jax.show.figures import most_demonstrated, number_given, split
from ailsrs_jax.show.reports.charts import Chart, Line, Panel
from ailsrs_jax.sweeps.results import SweepResults
from ailsrs_jax.sweeps.statistics import Group, mean_curve
from ailsrs_jax.trainers.parts.reference import CLOSE

SCORES = (
    "The gap between the discriminator's scores of expert (dashed) and policy (solid) shows how "
    "well it tells them apart. Near 0.5 it cannot. At 1 and 0 it has won, and the policy learns "
    "nothing more from it."
)
MEANS = "A line is the mean over all seeds; the area reaches from the worst to the best seed."


def seed_name(seed: int) -> str:
    """Return the name of a seed's lines."""
    return f"seed {seed}"


def draw_run(run: SavedRun, colors: Mapping[str, str]) -> Chart:
    """Draw what the run has measured of each seed; a dot marks the policy that is kept."""
    expert = run.comparable_expert_return
    levels = {
        "evaluation_return": {} if expert is None else {"expert": expert},
        "expert_distance": {"close to the expert": CLOSE},
        "policy_score": {"cannot tell": EVEN},
    }
    panels = []
    for column in (name for name in PANELS if name in run.metrics):
        label, limits = PANELS[column]
        if column == "evaluation_return" and run.imitates:
            label = "return, not trained on"
        lines = []
        for seed, mine in by_seed(run).items():
            name, steps = seed_name(seed), mine["env_steps"] / 1e6
            at = mine["iteration"] == run.kept_iterations.get(seed)
            is_score = column == "policy_score"
            lines += _score_lines(name, mine) if is_score else [Line(name, steps, mine[column])]
            lines.append(Line(name, steps[at], mine[column][at], "marks", note="kept"))
        panels.append(Panel("", STEPS, label, lines, levels.get(column, {}), limits))
    caption = f"A dot marks the iteration whose policy is kept. {SCORES}"
    return Chart("Training", panels, colors, caption)


def draw_series(
    groups: Sequence[Group], results: SweepResults, colors: Mapping[str, str]
) -> Chart | None:
    """Draw the mean return of each series over training, a panel for each task.

    The curves are those with the most demonstrations, and of all seeds.
    """
    panels = []
    for task, mine in split(groups, "env_id").items():
        chosen = most_demonstrated(mine, results.curves)
        lines = []
        for group, curves in chosen:
            mean = mean_curve(curves)
            returns = np.array([curve.returns[: len(mean.returns)] for curve in curves])
            band = np.fmin.reduce(returns), np.fmax.reduce(returns)
            steps = mean.env_steps / 1e6
            look = "line" if len(steps) > 1 else "marks"  # of a single iteration
            lines.append(Line(group.series, steps, mean.returns, look, band, seeds(len(curves))))
        if lines:
            levels = _levels([group for group, _ in chosen if group.has_comparable_curves])
            panels.append(Panel(task, STEPS, "return", lines, levels))
    most = " The runs are those with the most demonstrations."
    caption = MEANS + most * any(group.num_trajectories for group in groups)
    return Chart("Training", panels, colors, caption) if panels else None


def draw_numbers(groups: Sequence[Group], colors: Mapping[str, str]) -> Chart | None:
    """Draw the return of the kept policy against the number of demonstrations."""
    given = [group for group in groups if group.num_trajectories is not None]
    if len({group.num_trajectories for group in given}) < 2:
        return None
    panels = []
    for task, mine in split(given, "env_id").items():
        by_series = split(sorted(mine, key=number_given), "series")
        lines = []
        for name in (name for name in colors if name in by_series):
            numbers = np.array([number_given(group) for group in by_series[name]], float)
            returns = [group.values("return_mean") for group in by_series[name]]
            mean, low, high = (
                np.array([how(values) for values in returns]) for how in (np.mean, np.min, np.max)
            )
            counts = {len(values) for values in returns}
            lines.append(Line(name, numbers, mean, band=(low, high), note=seeds(*counts)))
        panels.append(Panel(task, "demonstrations", "return", lines, _levels(mine)))
    title = "Return of the kept policy against the number of demonstrations"
    return Chart(title, panels, colors, MEANS)


def draw_discriminators(
    groups: Iterable[Group], runs: Mapping[str, SavedRun], colors: Mapping[str, str]
) -> Chart | None:
    """Draw the discriminator's scores of all ``runs``, by cell, that have one."""
    tasks: dict[str, list[Line]] = {}
    for group in groups:
        for cell in group.cells:
            if cell.cell in runs and "policy_score" in runs[cell.cell].metrics:
                lines = _score_lines(group.series, runs[cell.cell].metrics)
                tasks.setdefault(group.env_id, []).extend(lines)
    label, limits = PANELS["policy_score"]
    panels = [
        Panel(task, STEPS, label, lines, {"cannot tell": EVEN}, limits)
        for task, lines in tasks.items()
    ]
    return Chart("Discriminator's scores", panels, colors, SCORES) if panels else None


def _score_lines(name: str, metrics: Mapping[str, np.ndarray]) -> list[Line]:
    steps = metrics["env_steps"] / 1e6
    lines = [Line(name, steps, metrics["policy_score"], note="the policy")]
    if "expert_score" in metrics:
        lines.append(Line(name, steps, metrics["expert_score"], "dashed", note="the expert"))
    return lines


def _levels(groups: Sequence[Group]) -> dict[str, float]:
    """Return the mean returns of random actions and of each source of demonstrations."""
    levels: dict[str, list[np.ndarray]] = {}
    for group in groups:
        source = group.cells[0].demonstrations
        name = f"expert ({source})" if source else "expert"
        levels.setdefault(name, []).append(group.values("expert_return"))
        levels.setdefault("random", []).append(group.values("random_return"))
    return {name: float(np.concatenate(returns).mean()) for name, returns in levels.items()}


def seeds(*numbers: int) -> str:
    """Return a number of seeds, or the smallest and the largest, for people."""
    least, most = min(numbers), max(numbers)
    return f"{most} seed{'s' * (most > 1)}" if least == most else f"{least} to {most} seeds"
