"""The rules that compare the results of sweeps with the claims of the paper.

A rule is a function that turns results into checks. ``claims.py`` states it in words, and
``evidence.py`` turns the checks into a verdict.
"""

import itertools
from collections.abc import Callable, Iterable, Sequence
from functools import partial

import numpy as np

from ailsrs_jax.show.sweep_report import estimate, plus_minus
from ailsrs_jax.sweeps.statistics import Group, interquartile_mean, median_reached, scores
from experiments.evidence import (
    ABLATIONS,
    CHEETAH,
    FEWEST,
    FIGURE_2,
    FIGURE_3,
    HARD,
    HARD_TASKS,
    HOPPER,
    MOST,
    NUMBERS,
    PAPER_CLONES,
    PAPER_EXPERTS,
    REACHED,
    SWIMMER,
    TASKS,
    WALKER,
    Check,
    Evidence,
)


def short(task: str) -> str:
    """Return the name of the task without its version."""
    return task.partition("-")[0]


def share(group: Group) -> float:
    """Return the mean return as a share of the expert's."""
    return float(group.values("return_mean").mean() / group.values("expert_return").mean())


def paper_share(task: str, number: int) -> float:
    """Return the share of the expert's return that the paper's behaviour cloning reaches."""
    return PAPER_CLONES[task][number] / PAPER_EXPERTS[task]


def close_to_paper(ours: float, task: str, number: int) -> bool:
    """Whether a clone's share of the expert's return is within 0.1 of the paper's."""
    return abs(ours - paper_share(task, number)) <= 0.1


def score(group: Group) -> float:
    """Return the mean normalised return."""
    return float(group.values("normalized").mean())


def spread(evidence: Evidence, label: str, task: str) -> float:
    """Return the standard deviation of the normalised return over seeds.

    It is pooled over the numbers of demonstrations, because three seeds give a rough figure.
    """
    groups = [evidence.group(label, task, number) for number in NUMBERS]
    variances = [group.values("normalized").var(ddof=1) for group in groups]
    return float(np.sqrt(np.mean(variances)))


def largest_fall(curve: np.ndarray) -> float:
    """Return the largest difference between an earlier maximum of the curve and its value."""
    return float((np.maximum.accumulate(curve) - curve).max())


def reaches(
    evidence: Evidence,
    label: str,
    tasks: Sequence[str],
    numbers: Sequence[int | None] = (None,),
    sweep: str = FIGURE_2,
) -> Iterable[Check]:
    """Check that the mean normalised return of the kept policies is at least 0.9."""
    for task, number in itertools.product(tasks, numbers):
        group = evidence.group(label, task, number, sweep)
        value = plus_minus(group.values("normalized"), 3)
        yield Check(_where(task, number), value, score(group) >= REACHED)


def steadier(evidence: Evidence, label: str, other: str, tasks: Sequence[str]) -> Iterable[Check]:
    """Check that the spread of ``label`` over seeds is at most that of ``other``."""
    for task in tasks:
        mine, theirs = (spread(evidence, name, task) for name in (label, other))
        yield Check(_where(task, None), f"{mine:.3f} against {theirs:.3f}", mine <= theirs)


def higher(
    evidence: Evidence, label: str, other: str, task: str, at_most: float = np.inf
) -> Iterable[Check]:
    """Check that ``label`` scores higher than ``other``, by no more than ``at_most``."""
    for number in NUMBERS:
        mine, theirs = (score(evidence.group(name, task, number)) for name in (label, other))
        yield Check(f"{number}:", f"{mine:.3f} against {theirs:.3f}", 0 < mine - theirs <= at_most)


def cloned_to(evidence: Evidence, task: str, number: int) -> Iterable[Check]:
    """Check that BC's share of the expert's return is close to the paper's."""
    group = evidence.group("BC", task, number)
    ours = share(group)
    value = f"{plus_minus(group.values('return_mean'))}, {ours:.2f} of the expert"
    yield Check("", value, close_to_paper(ours, task, number))


def cloning_rises(evidence: Evidence, task: str) -> Iterable[Check]:
    """Check that BC's mean return rises with each further ten demonstrations."""
    means = [evidence.group("BC", task, n).values("return_mean").mean() for n in NUMBERS]
    for number, before, after in zip(NUMBERS[1:], means, means[1:]):
        yield Check(f"{number}:", f"{before:.0f} → {after:.0f}", after > before)


def curves_reach(evidence: Evidence, task: str, seeds: Sequence[int]) -> Iterable[Check]:
    """Check that the smoothed mean training curves of these numbers of seeds reach 0.9."""
    group = evidence.group("AILSRS", task, sweep=FIGURE_3)
    for number in seeds:
        peak = evidence.curve(group, number, FIGURE_3).max()
        yield Check(f"{number} seed{'s' * (number > 1)}:", f"{peak:.2f}", peak >= REACHED)


def above_the_expert(evidence: Evidence, label: str, task: str) -> Iterable[Check]:
    """Check that the mean return is above the expert's from 20, 30 and 40 demonstrations."""
    for number in NUMBERS[1:]:
        group = evidence.group(label, task, number)
        value = f"{plus_minus(group.values('return_mean'))}, {share(group):.2f} of the expert"
        yield Check(f"{number}:", value, share(group) > 1)


def within_five_percent(evidence: Evidence, label: str) -> Iterable[Check]:
    """Check that the mean return on Walker2d is within 5 % of the expert's, as in the paper."""
    for number in NUMBERS:
        ours = share(evidence.group(label, WALKER, number))
        yield Check(f"{number}:", f"{ours:.2f}", abs(ours - 1) <= 51.05 / 1021)


def every_seed_reaches(
    evidence: Evidence, label: str, tasks: Sequence[str], numbers: Sequence[int]
) -> Iterable[Check]:
    """Check that the normalised return of each seed is at least 0.9."""
    for task, number in itertools.product(tasks, numbers):
        worst = evidence.group(label, task, number).values("normalized").min()
        yield Check(_where(task, number), f"worst {worst:.3f}", worst >= REACHED)


def _few_and_many(
    evidence: Evidence, label: str, holds: Callable[[float, float], bool]
) -> Iterable[Check]:
    """Compare the mean normalised returns from ten and from forty demonstrations."""
    for task in TASKS:
        few, many = (score(evidence.group(label, task, n)) for n in (FEWEST, MOST))
        yield Check(short(task), f"{few:.2f}, {many:.2f}", holds(few, many))


few_are_enough = partial(
    _few_and_many, label="AILSRS", holds=lambda few, many: few >= max(REACHED, many - 0.05)
)
cloning_needs_data = partial(
    _few_and_many, label="BC", holds=lambda few, many: few < REACHED and many >= few + 0.1
)


def competitive(evidence: Evidence) -> Iterable[Check]:
    """AILSRS's interquartile mean is not below the intervals of GAIL's and BC's."""
    iqm = {
        label: interquartile_mean(
            scores(evidence.group(label, task, n) for task in TASKS for n in NUMBERS)
        )
        for label in ("AILSRS", "GAIL", "BC")
    }
    for label in ("GAIL", "BC"):
        value = f"{estimate(iqm['AILSRS'])} against {estimate(iqm[label])}"
        yield Check(f"{label}:", value, bool(iqm["AILSRS"].value >= iqm[label].low))


def all_six(evidence: Evidence) -> Iterable[Check]:
    """AILSRS reaches 0.9 on all six locomotion tasks of Gym."""
    yield from reaches(evidence, "AILSRS", TASKS, [MOST])
    yield from reaches(evidence, "AILSRS", HARD_TASKS, sweep=HARD)


def hard_tasks_fail(evidence: Evidence) -> Iterable[Check]:
    """AILSRS reaches 0.9 neither on Ant nor on Humanoid, not even for a while."""
    for task in HARD_TASKS:
        group = evidence.group("AILSRS", task, sweep=HARD)
        steps = _steps(float(np.median(group.values("env_steps"))))
        value = f"{plus_minus(group.values('normalized'), 3)} after {steps} steps"
        yield Check(_where(task, None), value, score(group) < REACHED)
        reached = median_reached(group.values("steps_to_90"))[0]
        yield Check(_where(task, None), f"0.9 after {_steps(reached)}", np.isinf(reached))


def faster_than_gail(evidence: Evidence) -> Iterable[Check]:
    """AILSRS reaches 90 % of the expert in less time than GAIL."""
    for task in TASKS:
        groups = [evidence.group(label, task, FEWEST) for label in ("AILSRS", "GAIL")]
        ours, theirs = (median_reached(times)[0] for times in evidence.seconds(groups))
        yield Check(short(task), f"{_seconds(ours)} against {_seconds(theirs)}", ours < theirs)


def gail_needs_more_interaction(evidence: Evidence) -> Iterable[Check]:
    """GAIL reaches 90 % of the expert after more environment steps than AILSRS."""
    for task in TASKS:
        groups = [evidence.group(label, task, FEWEST) for label in ("GAIL", "AILSRS")]
        theirs, ours = (median_reached(group.values("steps_to_90"))[0] for group in groups)
        yield Check(short(task), f"{_steps(theirs)} against {_steps(ours)}", theirs > ours)


def cloned_start_is_faster(evidence: Evidence) -> Iterable[Check]:
    """AILSRS from BC reaches 90 % of the expert in fewer steps than from zero, or more often."""
    for task in (HOPPER, CHEETAH):
        (cloned, often), (zero, seldom) = (
            median_reached(evidence.group(label, task, sweep=ABLATIONS).values("steps_to_90"))
            for label in ("tuned", "from zero")
        )
        value = f"{_steps(cloned)}, {often} seeds, against {_steps(zero)}, {seldom} seeds"
        yield Check(short(task), value, (cloned, -often) < (zero, -seldom))


def least_squares_is_steadier(evidence: Evidence) -> Iterable[Check]:
    """Least squares is higher over training than cross entropy, with a smaller largest fall."""
    for task in (HOPPER, CHEETAH):
        groups = [
            evidence.group(label, task, sweep=ABLATIONS) for label in ("tuned", "cross entropy")
        ]
        over, other_over = (group.values("normalized_over_training").mean() for group in groups)
        fall, other_fall = (
            largest_fall(evidence.curve(group, len(group.cells), ABLATIONS)) for group in groups
        )
        where = short(task)
        yield Check(where, f"over training {over:.2f} against {other_over:.2f}", over > other_over)
        yield Check(where, f"fall {fall:.2f} against {other_fall:.2f}", fall < other_fall)


def thirty_is_best(evidence: Evidence) -> Iterable[Check]:
    """BC on Walker2d has its highest mean return from thirty demonstrations."""
    means = {n: evidence.group("BC", WALKER, n).values("return_mean").mean() for n in NUMBERS}
    best = max(means, key=lambda number: means[number])
    yield Check("best with", str(best), best == 30)


def swimmer_is_easiest_to_clone(evidence: Evidence) -> Iterable[Check]:
    """From ten demonstrations, BC is nearer to the expert on Swimmer than elsewhere."""
    shares = {task: share(evidence.group("BC", task, FEWEST)) for task in TASKS}
    for task in TASKS[:3]:
        value = f"{shares[SWIMMER]:.2f} against {shares[task]:.2f}"
        yield Check(short(task), value, shares[SWIMMER] > shares[task])


def two_tasks_are_easier(evidence: Evidence) -> Iterable[Check]:
    """Each algorithm scores higher on Walker2d and Swimmer than on HalfCheetah and Hopper."""
    for label in ("BC", "GAIL", "AILSRS"):
        easy, hard = (
            np.mean([score(evidence.group(label, task, n)) for task in tasks for n in NUMBERS])
            for tasks in ((WALKER, SWIMMER), (CHEETAH, HOPPER))
        )
        yield Check(label, f"{easy:.2f} against {hard:.2f}", bool(easy > hard))


def hopper_is_steadier_to_clone(evidence: Evidence) -> Iterable[Check]:
    """BC's spread over seeds is smaller on Hopper than on HalfCheetah."""
    ours, other = (spread(evidence, "BC", task) for task in (HOPPER, CHEETAH))
    yield Check("", f"{ours:.3f} against {other:.3f}", ours < other)


def swimmer_is_steady(evidence: Evidence) -> Iterable[Check]:
    """On Swimmer the spread over seeds is at most the paper's share of the expert's return."""
    for label in ("GAIL", "AILSRS"):
        for number in NUMBERS:
            group = evidence.group(label, SWIMMER, number)
            level = group.values("expert_return").mean() / PAPER_EXPERTS[SWIMMER]
            std = group.values("return_mean").std(ddof=1)
            yield Check(f"{label} {number}:", f"{std:.1f}", bool(std <= 4.51 * level))


def more_seeds_are_less_steady(evidence: Evidence) -> Iterable[Check]:
    """The largest fall of HalfCheetah's mean curve is larger with five seeds than with one."""
    group = evidence.group("AILSRS", CHEETAH, sweep=FIGURE_3)
    one, five = (largest_fall(evidence.curve(group, number, FIGURE_3)) for number in (1, 5))
    yield Check("largest fall", f"{one:.2f} with one, {five:.2f} with five", five > one)


def five_seeds_miss_on_hopper(evidence: Evidence) -> Iterable[Check]:
    """Hopper's mean curve reaches 0.9 with one and with three seeds, but not with five."""
    group = evidence.group("AILSRS", HOPPER, sweep=FIGURE_3)
    one, three, five = (evidence.curve(group, n, FIGURE_3).max() for n in (1, 3, 5))
    value = f"{one:.2f}, {three:.2f}, {five:.2f}"
    yield Check("peaks of 1, 3, 5 seeds:", value, bool(five < REACHED <= min(one, three)))


def _where(task: str, number: int | None) -> str:
    return f"{short(task)} {number}:" if number else f"{short(task)}:"


def _seconds(value: float) -> str:
    return f"{value:.0f} s" if np.isfinite(value) else "never"


def _steps(value: float) -> str:
    return f"{value / 1e6:.2f} M" if np.isfinite(value) else "never"
