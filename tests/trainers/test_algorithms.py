"""Every algorithm by its name: the same run directory, the same resume, the same complaints."""

import csv
import json
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest

import ailsrs_jax as ail
from ailsrs_jax.data.demonstrations import Demonstrations
from ailsrs_jax.runs.storage.metrics import IterationReport
from ailsrs_jax.runs.storage.saved_run import read_run
from ailsrs_jax.trainers.algorithms import ALGORITHMS
from tests.point_mass import PointMass

COMMON = {"num_iterations": 3, "episode_length": 20}
SEARCH = COMMON | {"num_directions": 4, "num_top_directions": 2}
TRUST_REGION = COMMON | {"updates_per_iteration": 1, "num_envs": 4, "batch_size": 80}
DISTANCE = {"num_distance_samples": 50}
TINY: dict[str, dict[str, Any]] = {
    "ailsrs": SEARCH | DISTANCE | {"discriminator_batch_size": 16, "memory_samples": 16},
    "bc": COMMON | DISTANCE | {"gradient_steps": 5},
    "gail": TRUST_REGION
    | DISTANCE
    | {"discriminator_batch_size": 16, "behavior_cloning_steps": 20},
    "ars": SEARCH,
    "brs": SEARCH,
    "trpo": TRUST_REGION,
}


@pytest.mark.usefixtures("many_devices")
@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_all_leave_the_same_behind(
    algorithm: str, point_mass: PointMass, point_mass_expert: Demonstrations, tmp_path: Path
) -> None:
    imitates = ALGORITHMS[algorithm].imitates
    arguments: dict[str, Any] = TINY[algorithm] | {
        "demonstrations": point_mass_expert if imitates else None,
        "algorithm": algorithm,
        "seeds": (3, 4),
        "output": tmp_path / "run",
    }
    result = ail.train(point_mass, **arguments)
    assert (result.expert_returns is not None) == imitates
    config = json.loads((tmp_path / "run" / "config.json").read_text())
    assert config["algorithm"] == algorithm
    assert (config["demonstrations_sha256"] is not None) == imitates
    with (tmp_path / "run" / "metrics.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [(row["iteration"], row["seed"]) for row in rows] == [
        (str(iteration), seed) for iteration in range(3) for seed in ("3", "4")
    ]
    shared = {"evaluation_return", "evaluation_length", "env_steps"}
    assert shared | ({"expert_distance"} if imitates else set()) <= rows[0].keys()
    assert np.isfinite([[float(value) for value in row.values()] for row in rows]).all()
    assert read_run(tmp_path / "run").kept_iterations == result.kept_iterations
    for seed, policy in result.policies.items():
        saved = ail.load_policy(tmp_path / "run" / f"seed_{seed}" / "policy.npz")
        observation = np.array([0.3, -0.2])
        np.testing.assert_allclose(saved(observation), policy(observation), rtol=1e-6)
        assert ail.evaluate(saved, 2, env=point_mass, episode_length=20).lengths.max() <= 20

    reports: list[int] = []

    def stop_once(report: IterationReport) -> None:
        reports.append(report.iteration)
        if len(reports) == 2:
            raise KeyboardInterrupt

    arguments |= {"output": tmp_path / "stopped", "checkpoint_every": 1, "watch": stop_once}
    with pytest.raises(KeyboardInterrupt):
        ail.train(point_mass, **arguments)
    again = ail.train(point_mass, **arguments, resume=True)
    assert reports == [0, 1, 2]
    for seed in result.policies:
        jax.tree.map(
            np.testing.assert_array_equal,
            *(vars(run.policies[seed]) | {"env_id": 0} for run in (result, again)),
        )


def test_cloning_ends_a_run_early(
    point_mass: PointMass, point_mass_expert: Demonstrations, tmp_path: Path
) -> None:
    """And there is nothing to go on with, either."""
    arguments: dict[str, Any] = TINY["bc"] | {"solver": "ridge", "output": tmp_path / "run"}
    reports: list[Any] = []
    for resume in (False, True):
        ail.train(
            point_mass,
            point_mass_expert,
            algorithm="bc",
            watch=reports.append,
            resume=resume,
            **arguments,
        )
    assert [report.iteration for report in reports] == [0]
    assert reports[0].is_last


def test_mistakes(point_mass: PointMass, point_mass_expert: Demonstrations) -> None:
    calls = {
        "unknown algorithm 'sac': use one of ailsrs, bc, gail": {"algorithm": "sac"},
        "ars learns from the environment's reward": {"algorithm": "ars"},
        "no setting 'num_directions' (did you mean num_iterations?)": {
            "algorithm": "gail",
            "num_directions": 3,
        },
        "validation_fraction is 1.5: it must be at most 1": {
            "algorithm": "bc",
            "validation_fraction": 1.5,
        },
        "32 bits, below 2^31": {"algorithm": "bc", "num_evaluation_episodes": 2**26},
        "batch_size is 7: it must be a multiple": {"algorithm": "gail", "batch_size": 7},
        "reward_after_end is 0.5: imitation_reward=airl": {"imitation_reward": "airl"},
        "it must be least_squares, cross_entropy or a function": {"discriminator_loss": "hinge"},
    }
    for message, arguments in calls.items():
        with pytest.raises(ail.UserError) as caught:
            ail.train(point_mass, point_mass_expert, **arguments)
        assert message in str(caught.value)
    for make, settings in (
        (ail.make_ars, ail.ArsSettings(num_directions=2)),
        (ail.make_trpo, ail.TrpoSettings(max_divergence=0.0)),
    ):
        with pytest.raises(ail.UserError, match="it must be"):
            make(point_mass, settings)
    with pytest.raises(ail.UserError, match="hold no actions, which behaviour cloning needs"):
        ail.train(point_mass, point_mass_expert.replace(actions=None), algorithm="bc")


@pytest.mark.parametrize("algorithm", [name for name in ALGORITHMS if ALGORITHMS[name].imitates])
def test_demonstrations_of_other_sizes_are_refused(
    algorithm: str, point_mass: PointMass, point_mass_expert: Demonstrations
) -> None:
    make, settings = ALGORITHMS[algorithm].make, ALGORITHMS[algorithm].settings(**TINY[algorithm])
    narrow = point_mass_expert.replace(observations=point_mass_expert.observations[..., :1])
    with pytest.raises(ail.UserError, match="the environment has 2 and 1"):
        make(point_mass, narrow, settings)
