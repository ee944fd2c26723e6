"""Judge a run by its own records, without the environment's reward."""

import dataclasses
from collections.abc import Iterator, Mapping

import numpy as np

from ailsrs_jax.errors import UserError
from ailsrs_jax.runs.storage.saved_run import SavedRun
from ailsrs_jax.trainers.parts.reference import CLOSE, verdict

WON = 0.9  # the gap of the scores from which the discriminator has won


@dataclasses.dataclass(frozen=True)
class SeedInspection:
    """What the records say about one seed of a run."""

    seed: int
    kept_iteration: int
    distance: float  # of the kept policy to the expert, by energy distance
    verdict: str
    reasons: tuple[str, ...]  # why it is not close, one line each with a figure


def inspect_run(run: SavedRun) -> list[SeedInspection]:
    """Judge each seed of a run by the distance of its kept policy.

    The reasons are those of the table in docs/debugging.md.

    Raises:
        UserError: the algorithm does not imitate, or a row of the metrics is missing.
    """
    if not {"expert_distance", "evaluation_length"} <= set(run.metrics):
        raise UserError(f"{run.directory} is of an algorithm that does not measure its distance")
    found = []
    for seed, metrics, row in run.kept_rows():
        distance = float(metrics["expert_distance"][row])
        why = [] if distance <= CLOSE else reasons(metrics, row, run.demonstrated_length)
        kept = run.kept_iterations[seed]
        found.append(SeedInspection(seed, kept, distance, verdict(distance), tuple(why)))
    return found


def reasons(
    metrics: Mapping[str, np.ndarray], kept: int, demonstrated_length: int | None
) -> Iterator[str]:
    """Yield what is wrong in the ``metrics`` of a seed that kept its policy of row ``kept``."""
    diverged = int(np.sum(metrics.get("diverged", 0)))
    if diverged:
        yield f"{diverged} episodes diverged: the physics is unstable under these policies"
    if "policy_score" in metrics:
        expert, policy = metrics["expert_score"][-1], metrics["policy_score"][-1]
        if expert - policy > WON:
            yield f"the discriminator has won: scores {expert:.2f} of the expert, {policy:.2f}"
    distances = metrics["expert_distance"]
    length = float(metrics["evaluation_length"][kept])
    if demonstrated_length is not None and length < 0.9 * demonstrated_length:
        yield f"episodes end early: {length:.0f} steps of {demonstrated_length}"
    if len(distances) > 2 and distances[kept] > 0.8 * distances[0]:
        yield f"the distance has hardly fallen: it began at {distances[0]:.2f}"
    elif np.argmin(np.nan_to_num(distances, nan=np.inf)) >= 0.8 * (len(distances) - 1):
        yield "the distance still falls: more iterations may help"
    elif distances[-1] > 1.5 * distances[kept]:
        yield f"the search drifted away from this policy: the last distance is {distances[-1]:.2f}"
