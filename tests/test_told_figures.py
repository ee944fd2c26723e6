"""The figures in README and docs are those of the committed results."""

import csv
import itertools
import re
from collections.abc import Iterable, Mapping

import numpy as np
import pytest

from ailsrs_jax.show.sweep_report import estimate, plus_minus
from ailsrs_jax.sweeps.results import CellResult
from ailsrs_jax.sweeps.statistics import (
    Group,
    group_cells,
    interquartile_mean,
    median_reached,
    probability_of_improvement,
    scores,
    shared_scores,
)
from ailsrs_jax.trainers.parts import reference
from tests.sweeps.synthetic_sweep import HARD_TASKS, TASKS

pytest.importorskip("experiments.results", reason="the package is installed without them")
from experiments import results
from experiments.evidence import (
    CHEETAH,
    FEWEST,
    FIGURE_2,
    FIGURE_2_LINEAR,
    HARD,
    HOPPER,
    NUMBERS,
    SWIMMER,
    WALKER,
    Evidence,
)
from experiments.rules import score

LABELS = ("AILSRS", "GAIL")
README = results.PAGE.parent.parent / "README.md"


def test_the_readme_agrees_with_the_committed_results() -> None:
    readme = README.read_text()
    sweeps = results.read_all(results.RESULTS)
    evidence, linear = Evidence(sweeps), Evidence({FIGURE_2: sweeps[FIGURE_2_LINEAR]})
    conditions = list(itertools.product(TASKS, NUMBERS))
    clones = [
        plus_minus(evidence.group("neural BC", task, FEWEST).values("normalized"), 2)
        for task in (CHEETAH, HOPPER, SWIMMER)
    ]
    assert "{} on HalfCheetah, {} on Hopper, {} on Swimmer".format(*clones) in readme
    for label in LABELS:
        groups = [evidence.group(label, *where) for where in conditions]
        assert estimate(interquartile_mean(scores(groups))) in readme, label
        hard = [evidence.group(label, task, sweep=HARD) for task in HARD_TASKS]
        values = [plus_minus(group.values("normalized"), 2) for group in hard]
        assert " and ".join(values) in readme, label
    pairs = [
        [np.mean([score(evidence.group(label, task, n)) for n in NUMBERS]) for label in LABELS]
        for task in (CHEETAH, HOPPER, WALKER, SWIMMER)
    ]
    told = (
        "AILSRS and GAIL return {:.2f} and {:.2f} on HalfCheetah, {:.2f} and {:.2f} on Hopper, "
        "{:.2f} and {:.2f} on Walker2d, and {:.2f} and {:.2f} on Swimmer."
    )
    assert told.format(*np.ravel(pairs)) in readme
    iqms = [
        estimate(interquartile_mean(scores(linear.group(label, *where) for where in conditions)))
        for label in LABELS
    ]
    assert "With linear experts, the interquartile means are {} and {}.".format(*iqms) in readme
    (claims,) = re.findall(r"(?m)^\*\*(\d+ claims): (.+)\.\*\*$", results.PAGE.read_text())
    total, verdicts = claims
    reproduced, partly, rest = re.findall(r"\d+", verdicts)
    summary = f"Of {total}, {reproduced} are reproduced, {partly} partly, {rest} not."
    assert summary in readme


def medians(cells: Iterable[CellResult], label: str, seeds: Mapping[str, range]) -> str:
    """Three fields of a table: median and worst seed on HalfCheetah, Hopper and Swimmer."""
    shown = []
    for task in (CHEETAH, HOPPER, SWIMMER):
        mine = [c for c in cells if (c.label, c.env_id) == (label, task) and c.done]
        assert sorted(cell.seed for cell in mine) == list(seeds[task]), task
        values = np.array([cell.normalized for cell in mine])
        median, worst = np.round([np.median(values), values.min()], 2) + 0.0  # no minus zero
        shown.append(f"{median:.2f}, {worst:.2f}")
    return " | ".join(shown)


def test_the_readme_agrees_with_the_results_from_little_data() -> None:
    sweeps, readme = results.read_all(results.RESULTS), README.read_text()
    rows = {  # their sweep, label and number of seeds, and the first seed on Hopper and Swimmer
        "AILSRS, a linear policy": ("little_data", "AILSRS, 50 transitions", 10, 10),
        "AILSRS, a network (`policy=mlp`)": ("network", "AILSRS, 50 transitions", 5, 10),
        "GAIL, a network": ("little_data", "GAIL, 50 transitions", 5, 0),
        "a neural clone": ("little_data", "neural BC, 50 transitions", 10, 0),
        "AILSRS, ten episodes, actions inferred with the simulator": (
            "little_data",
            "AILSRS, states alone",
            3,
            10,
        ),
    }
    for name, (sweep, label, number, first) in rows.items():
        seeds = dict.fromkeys((HOPPER, SWIMMER), range(first, first + number))
        seeds[CHEETAH] = range(number)
        row = medians(sweeps[sweep].cells, label, seeds)
        assert f"| {name} | {number} | {row} |" in readme, name
    walker, clones = (
        plus_minus(group.values("normalized"), 2)
        for group in group_cells(sweeps["network"].cells)
        if group.env_id == "Walker2d-v5"
    )
    assert f"five seeds return {walker}, and their clones {clones}." in readme


def test_the_readme_agrees_with_the_results_from_little_data_on_ant_and_walker2d() -> None:
    groups = group_cells(results.read_all(results.RESULTS)["little_data"].cells)
    found = {
        (group.series, group.env_id): plus_minus(group.values("normalized"), 2) for group in groups
    }
    fields = [
        found[label, task]
        for label in ("AILSRS, 50 transitions", "neural BC, 50 transitions", "AILSRS, states alone")
        for task in ("Ant-v5", WALKER)
    ]
    told = (
        "five seeds return {} and {}, and neural clones {} and {}. From ten episodes without "
        "actions, three seeds return {} on Ant and {} on Walker2d."
    )
    assert told.format(*fields) in README.read_text()


def ours_and_gail(cells: Iterable[CellResult]) -> list[dict[str, Group]]:
    """The groups of AILSRS and of GAIL from fifty transitions, by task."""
    groups = group_cells(cells)
    return [
        {group.env_id: group for group in groups if group.series == f"{name}, 50 transitions"}
        for name in ("AILSRS", "GAIL")
    ]


def over_gail(mine: Mapping[str, Group], gail: Mapping[str, Group]) -> str:
    """The probability that a run of AILSRS scores higher, with its interval."""
    return estimate(probability_of_improvement(shared_scores(mine.values(), gail.values())))


def test_the_readme_agrees_with_the_results_of_linear_experts() -> None:
    cells, readme = results.read_all(results.RESULTS)["linear_experts"].cells, README.read_text()
    names = {
        "AILSRS, a linear policy": "AILSRS",
        "GAIL, a network": "GAIL",
        "a neural clone": "neural BC",
        "a linear clone": "linear clone",
        "a linear clone without an intercept": "BC",
    }
    seeds = dict.fromkeys((CHEETAH, HOPPER, SWIMMER), range(5))
    for name, label in names.items():
        row = medians(cells, f"{label}, 50 transitions", seeds)
        assert f"| {name} | {row} |" in readme, name
    chance = over_gail(*ours_and_gail(cells))
    assert f"scores higher than one of GAIL with a probability of {chance}." in readme


def test_the_readme_compares_with_gail_as_the_results_do() -> None:
    mine, gail = ours_and_gail(results.read_all(results.RESULTS)["little_data"].cells)
    chance = over_gail(mine, gail)
    reached = [median_reached(each[HOPPER].values("steps_to_90"))[0] / 1e6 for each in (mine, gail)]
    steps, of_gail = (
        [each[task].values("env_steps").mean() / 1e6 for task in (CHEETAH, HOPPER, SWIMMER)]
        for each in (mine, gail)
    )
    for told in (
        f"than one of GAIL with a probability of {chance},",
        "it reaches 0.9 after {:.2f} M steps, and GAIL after {:.2f} M.".format(*reached),
        f"GAIL had {min(of_gail):.1f} to {max(of_gail):.1f} M steps,",
        "AILSRS had {:.1f} M steps on HalfCheetah, {:.1f} M on Hopper and {:.1f} M on Swimmer, "
        "as means.".format(*steps),
    ):
        assert told in README.read_text()


def test_the_readme_agrees_with_the_results_of_the_search() -> None:
    cells = results.read_all(results.RESULTS)["search"].cells
    table = [line for line in README.read_text().splitlines() if line.startswith("| ")]
    by_task = {
        task: [cell for cell in cells if cell.env_id == task and cell.done]
        for task in (CHEETAH, HOPPER, SWIMMER, *HARD_TASKS)
    }
    for task, each in by_task.items():
        first = 10 * (task in (HOPPER, SWIMMER))
        assert sorted(cell.seed for cell in each) == list(range(first, first + 10)), task
    returns = [np.array([cell.normalized for cell in each]) for each in by_task.values()]
    for name, shown in (
        ("mean", [plus_minus(values, 2) for values in returns]),
        ("worst seed", [f"{values.min():.2f}" for values in returns]),
    ):
        assert f"| {name} | {' | '.join(shown)} |" in table, name
    kept = {(cell.cell, f"{cell.kept_iteration:.0f}"): cell.normalized for cell in cells}
    verdicts: dict[str, list[float]] = {}
    with (results.RESULTS / "search" / "curves.csv").open() as file:
        for line in csv.DictReader(file):
            value = kept.get((line["cell"], line["iteration"]))
            if value is not None:
                judged = reference.verdict(float(line["expert_distance"]))
                verdicts.setdefault(judged, []).append(value)
    close, in_part = (verdicts[name] for name in ("close to the expert", "in part like the expert"))
    assert len(close) + len(in_part) == sum(map(len, by_task.values()))
    assert (
        f"it calls {len(close)} *close to the expert*, which return {min(close):.2f} or more, and "
        f"{len(in_part)} *in part like the expert*, which return {min(in_part):.2f} to "
        f"{max(in_part):.2f}."
    ) in README.read_text()
