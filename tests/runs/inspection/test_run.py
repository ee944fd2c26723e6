"""What ``ailsrs inspect`` tells about a run."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ailsrs_jax.errors import UserError
from ailsrs_jax.runs.inspection.run import inspect_run, reasons
from ailsrs_jax.runs.storage.saved_run import read_run
from tests.runs.toy_run import SEEDS, plan, run

HEALTHY: dict[str, Any] = {
    "expert_distance": np.array([4.0, 2.0, 0.9, 0.8, 0.9, 1.0]),
    "evaluation_length": np.full(6, 1000.0),
    "expert_score": np.full(6, 0.55),
    "policy_score": np.full(6, 0.45),
    "diverged": np.zeros(6),
}


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({}, None),
        ({"diverged": np.array([0, 0, 2, 0, 0, 0])}, "2 episodes diverged"),
        (
            {"expert_score": np.full(6, 0.97), "policy_score": np.full(6, 0.03)},
            "the discriminator has won: scores 0.97 of the expert, 0.03",
        ),
        ({"evaluation_length": np.full(6, 400.0)}, "episodes end early: 400 steps of 1000"),
        ({"expert_distance": np.array([4.0, 4.2, 4.1, 3.9, 4.0, 4.1])}, "it began at 4.00"),
        ({"expert_distance": np.array([4.0, 2.0, 0.9, 0.8, 1.1, 1.4])}, "the last distance is 1.4"),
        ({"expert_distance": np.array([4.0, 3.0, 2.0, 1.0, 0.9, 0.7])}, "still falls"),
    ],
)
def test_reasons_why_a_policy_is_not_close(changes: dict[str, Any], told: str | None) -> None:
    metrics = HEALTHY | changes
    found = list(reasons(metrics, int(np.argmin(metrics["expert_distance"])), 1000))
    assert len(found) == (told is not None), found
    assert told is None or told in found[0]


def test_a_late_policy_that_is_nearly_the_closest_does_not_still_fall() -> None:
    distances = np.array([4.0, 2.0, 0.8, 0.9, 1.3, 0.95])
    assert not list(reasons(HEALTHY | {"expert_distance": distances}, 5, 1000))


def test_distances_that_are_all_nan_are_no_error() -> None:
    metrics = HEALTHY | {"expert_distance": np.full(6, np.nan), "diverged": np.ones(6)}
    (found,) = reasons(metrics, 0, 1000)
    assert found.startswith("6 episodes diverged")


def test_a_run_is_judged(in_tmp_path: Path) -> None:
    result = run(plan(3, "ailsrs"), Path("out"))
    found = inspect_run(read_run(Path("out")))
    assert [seed.seed for seed in found] == list(SEEDS)
    for seed in found:
        assert seed.distance == pytest.approx(-result.scores[seed.seed], rel=1e-5)
        assert seed.kept_iteration == result.kept_iterations[seed.seed]
    path = Path("out/metrics.csv")
    path.write_text("".join(path.read_text().splitlines(keepends=True)[:2]))
    with pytest.raises(UserError, match=r"metrics.csv has no iteration \d of seed \d"):
        inspect_run(read_run(Path("out")))
    run(plan(2, "ars"), Path("rewarded"))
    with pytest.raises(UserError, match="does not measure its distance"):
        inspect_run(read_run(Path("rewarded")))
