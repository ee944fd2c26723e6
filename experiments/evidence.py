"""Judge a claim by checks of committed results.

A claim is *reproduced* if all checks hold, *partly* if at least half of them hold, and *not* if
fewer hold. A check needs every seed that the sweep was asked for; until then the claim is *not yet
run*.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from ailsrs_jax.sweeps.results import SweepResults
from ailsrs_jax.sweeps.statistics import Group, group_cells, mean_curve, smoothed

# The sweeps, experiments/NAME.toml.
FIGURE_2, FIGURE_3, ABLATIONS, HARD = "paper", "curves", "ablations", "ant_humanoid"
FIGURE_2_LINEAR, TABLE_1 = "paper_linear", "table_1"

CHEETAH, HOPPER, WALKER, SWIMMER = "HalfCheetah-v5", "Hopper-v5", "Walker2d-v5", "Swimmer-v5"
TASKS = (CHEETAH, HOPPER, WALKER, SWIMMER)
HARD_TASKS = ("Ant-v5", "Humanoid-v5")
NUMBERS = (10, 20, 30, 40)
FEWEST, MOST = NUMBERS[0], NUMBERS[-1]
# That the sweeps ask for.
NUM_SEEDS = {FIGURE_2: 3, FIGURE_3: 5, ABLATIONS: 5, HARD: 3, TABLE_1: 3}
REACHED = 0.9  # of the way from random to the expert
PAPER_EXPERTS = {CHEETAH: 4632.0, HOPPER: 3245.0, WALKER: 1021.0, SWIMMER: 362.0}
PAPER_CLONES = {  # returns of the paper's behaviour cloning, by the number of demonstrations
    CHEETAH: {10: 1000.0, 40: 4120.0},
    HOPPER: {10: 1200.0, 40: 3224.0},
    WALKER: {10: 862.745, 30: 890.823},
    SWIMMER: {10: 352.95},
}


class NotRunError(Exception):
    """A check needs results that do not exist yet; the message names them."""


class Check(NamedTuple):
    """One comparison."""

    where: str
    value: str  # our result
    holds: bool


class Finding(NamedTuple):
    """The verdict on a claim."""

    ours: str
    verdict: str


class Evidence:
    """The committed results by the name of their sweep."""

    def __init__(self, results: Mapping[str, SweepResults]) -> None:
        self._results = results
        self._groups = {name: group_cells(each.cells) for name, each in results.items()}

    def group(
        self, label: str, task: str, number: int | None = None, sweep: str = FIGURE_2
    ) -> Group:
        """Return the seeds of a label on a task from ``number`` demonstrations.

        Without ``number``, take the largest number of demonstrations there is.

        Raises:
            NotRunError: not all of them have been trained.
        """
        what = f"{label} on {task}" + (f" from {number}" if number else "")
        found = [
            group
            for group in self._groups.get(sweep, [])
            if (group.series, group.env_id) == (label, task)
            and number in (None, group.num_trajectories)
        ]
        if not found:
            raise NotRunError(what)
        group = max(found, key=lambda group: group.num_trajectories or 0)
        if len(group.cells) < max(group.num_planned, NUM_SEEDS[sweep]):
            raise NotRunError(f"{what}: {len(group.cells)} seeds")
        return group

    def seconds(self, groups: Sequence[Group]) -> list[np.ndarray]:
        """Return the seconds of each seed of each group to 90 % of the expert, NaN if never.

        The groups are of Figure 2.

        Raises:
            NotRunError: the times are missing or were measured on different hardware.
        """
        timings = self._results[FIGURE_2].timings
        names = [[cell.cell for cell in group.cells] for group in groups]
        hardware = {timings[name].hardware for each in names for name in each if name in timings}
        if len(hardware) != 1 or any(name not in timings for each in names for name in each):
            raise NotRunError(f"times on {groups[0].env_id} from one kind of machine")
        return [np.array([timings[name].seconds_to_90_percent for name in each]) for each in names]

    def curve(self, group: Group, num_seeds: int, sweep: str) -> np.ndarray:
        """Return the smoothed, normalised mean of the training curves of the first seeds."""
        curves = self._results[sweep].curves
        cells = sorted(group.cells, key=lambda cell: cell.seed)[:num_seeds]
        if len(cells) < num_seeds or any(cell.cell not in curves for cell in cells):
            raise NotRunError(f"{num_seeds} training curves of {group.series} on {group.env_id}")
        mean = mean_curve([curves[cell.cell] for cell in cells])
        return cells[0].normalize(smoothed(mean.returns))


Checks = Callable[[Evidence], Iterable[Check]]


class Claim(NamedTuple):
    """One claim of the paper."""

    text: str
    rule: str
    checks: Checks
    sweep: str = FIGURE_2  # the sweep whose results decide
    paper: str = ""  # the figure that the paper gives, if any


def judge(claim: Claim, evidence: Evidence) -> Finding:
    """Apply the rule of the claim."""
    try:
        checks = list(claim.checks(evidence))
    except NotRunError as error:
        return Finding(f"needs {error}", "not yet run")
    held = sum(check.holds for check in checks)
    verdict = (
        "reproduced" if held == len(checks) else "partly" if 2 * held >= len(checks) else "not"
    )
    many = len(checks) > 4
    parts = [f"{held} of {len(checks)} hold"] if many else []
    parts += [
        " ".join(filter(None, (where, value, "" if holds else "✗")))
        for where, value, holds in checks
        if not (many and holds)
    ]
    return Finding("; ".join(parts), verdict)
