"""Stacked runs equal the runs alone up to rounding, and draw the same random numbers."""

import csv
import dataclasses
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest

from ailsrs_jax.data.demonstrations import Demonstrations
from ailsrs_jax.errors import UserError
from ailsrs_jax.runs.loop import _Run, execute
from ailsrs_jax.runs.plan import Plan, plan
from ailsrs_jax.runs.spec import RunSpec
from ailsrs_jax.runs.stacking import stack_key
from ailsrs_jax.trainers.parts.rollout import Simulator
from tests.exploding import ExplodingPointMass
from tests.point_mass import PointMass
from tests.runs import toy_run
from tests.runs.storage.test_tracking import require_events
from tests.trainers.test_algorithms import TINY

# With more steps, small rounding differences would grow large.
FEW_STEPS = {"conjugate_gradient_steps": 1, "behavior_cloning_steps": 5}

# The settings that differ among the runs of a stack; their seeds differ too.
CHANGES: dict[str, list[dict[str, Any]]] = {
    "ailsrs": [
        {"num_trajectories": 8, "step_size": 0.05, "noise_std": 0.1},
        {"num_trajectories": 1, "gradient_penalty": 7.0, "discriminator_learning_rate": 1e-2},
    ],
    "bc": [{"num_trajectories": 8}, {"num_trajectories": 1, "learning_rate": 1e-2}],
    "gail": [
        FEW_STEPS | {"num_trajectories": 4},
        FEW_STEPS | {"max_divergence": 0.05, "discount": 0.9},
    ],
    "ars": [{}, {"noise_std": 0.1}],
    "trpo": [{}, {"value_learning_rate": 1e-2, "advantage_decay": 0.5}],
}


def one_device(*arguments: Any, **fields: Any) -> Plan:
    planned = plan(RunSpec(*arguments, **fields))
    return dataclasses.replace(planned, simulator=Simulator(planned.simulator.env))


def plans(env: PointMass, expert: Demonstrations, algorithm: str) -> list[Plan]:
    made = []
    for seed, changes in enumerate(CHANGES[algorithm]):
        settings = TINY[algorithm] | changes
        number = settings.pop("num_trajectories", None)
        made.append(
            one_device(
                env,
                expert if algorithm not in ("ars", "trpo") else None,
                algorithm=algorithm,
                num_trajectories=number,
                seeds=(seed,),
                settings=settings,
            )
        )
    return made


def execute_stack(cells: list[Plan], outputs: list[Path], stack: Path, **options: Any) -> list[Any]:
    """Train the cells together, or resume them."""
    return execute(cells, outputs, checkpoints=stack, resume="where begun", **options)


def metrics(path: Path) -> dict[str, np.ndarray]:
    with (path / "metrics.csv").open() as file:
        header, *rows = csv.reader(file)
    return dict(zip(header, np.array(rows, float).T, strict=True))


@pytest.mark.parametrize(
    "algorithm",
    [
        "ars",
        "bc",
        *(pytest.param(name, marks=pytest.mark.slow) for name in ("ailsrs", "gail", "trpo")),
    ],
)
def test_stacked_runs_are_those_alone(
    algorithm: str, point_mass: PointMass, point_mass_expert: Demonstrations, tmp_path: Path
) -> None:
    cells = plans(point_mass, point_mass_expert, algorithm)
    assert len(set(map(stack_key, cells))) == 1
    directories = [tmp_path / "stacked" / str(index) for index in range(len(cells))]
    stacked = execute_stack(cells, directories, tmp_path / "stack")
    for index, cell in enumerate(cells):
        alone = toy_run.run(cell, tmp_path / "alone" / str(index))
        (seed,) = cell.config.seeds
        assert stacked[index].kept_iterations == alone.kept_iterations
        ours, theirs = (vars(result.policies[seed]) for result in (stacked[index], alone))
        for name in ours.keys() - {"env_id"}:
            jax.tree.map(
                lambda x, y: np.testing.assert_allclose(x, y, rtol=1e-4, atol=1e-5),
                ours[name],
                theirs[name],
            )
        require_events(directories[index], (seed,))
        ours, theirs = metrics(directories[index]), metrics(tmp_path / "alone" / str(index))
        assert ours.keys() == theirs.keys()
        for name in ours:
            np.testing.assert_allclose(ours[name], theirs[name], rtol=1e-3, atol=1e-5)
        for name in ("iteration", "seed", "env_steps", "evaluation_length"):
            np.testing.assert_array_equal(ours[name], theirs[name])


def test_a_stack_goes_on_where_some_are_finished(
    point_mass: PointMass, point_mass_expert: Demonstrations, tmp_path: Path
) -> None:
    cells = [
        one_device(
            point_mass,
            point_mass_expert,
            algorithm="bc",
            settings={"num_iterations": 30, "patience": 1, "learning_rate": rate},
        )
        for rate in (1e-3, 0.3)
    ]

    def train(name: str, stop_after: int = 100) -> list[Any]:
        calls = iter(range(stop_after))
        return execute_stack(
            cells,
            [tmp_path / name / str(index) for index in range(2)],
            tmp_path / name / "stack",
            stop=lambda: next(calls, None) is None,
        )

    whole = train("whole")
    slow, fast = (len(metrics(tmp_path / "whole" / str(index))["iteration"]) for index in range(2))
    assert fast + 2 < slow
    with pytest.raises(KeyboardInterrupt):
        train("stopped", stop_after=fast + 1)
    for index, resumed in enumerate(train("stopped")):
        paths = (tmp_path / name / str(index) / "metrics.csv" for name in ("whole", "stopped"))
        assert len({path.read_bytes() for path in paths}) == 1
        np.testing.assert_array_equal(resumed.policies[0].weights, whole[index].policies[0].weights)


def test_a_seed_that_has_finished_waits_for_the_others(
    point_mass: PointMass, point_mass_expert: Demonstrations, tmp_path: Path
) -> None:
    settings = {"num_iterations": 30, "patience": 1, "learning_rate": 1e-3}

    def train(*seeds: int) -> tuple[dict[str, np.ndarray], Any]:
        name = tmp_path / "-".join(map(str, seeds))
        run = one_device(
            point_mass, point_mass_expert, algorithm="bc", seeds=seeds, settings=settings
        )
        (result,) = execute([run], [name])
        return metrics(name), result

    both, together = train(0, 1)
    lengths = []
    for seed in (0, 1):
        own, alone = train(seed)
        lengths.append(len(own["iteration"]))
        mine = both["seed"] == seed
        assert both["env_steps"][mine][-1] == own["env_steps"][-1]
        assert together.kept_iterations[seed] == alone.kept_iterations[seed]
    assert lengths[0] != lengths[1], lengths
    assert mine.sum() == max(lengths)


def test_what_diverges_in_a_stack_has_failed_whenever_one_asks(tmp_path: Path) -> None:
    env = ExplodingPointMass(share=0.45)
    cells = [
        one_device(env, algorithm="ars", seeds=(seed,), settings=TINY["ars"]) for seed in range(4)
    ]
    outputs = [tmp_path / str(seed) for seed in range(4)]

    def outcomes() -> list[str]:
        results = execute_stack(cells, outputs, tmp_path / "stack")
        return [str(result) if isinstance(result, UserError) else "done" for result in results]

    alone = []
    for cell in cells:
        try:
            toy_run.run(cell, tmp_path / "alone" / str(cell.config.seeds[0]))
            alone.append("done")
        except UserError as error:
            alone.append(str(error))
    assert 0 < alone.count("done") < 4
    assert outcomes() == alone
    assert outcomes() == alone  # a second call trains nothing


def test_the_states_of_a_stack_are_split_only_to_be_saved(
    point_mass: PointMass, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Splitting all arrays of all runs takes longer than a short iteration."""
    splits: list[int] = []
    on_device: list[bool] = []
    iteration = 0

    def split(self: _Run, lanes: Any) -> Any:
        if len(jax.tree.leaves(lanes)) > 1:  # not a counter
            splits.append(iteration)
        return original(self, lanes)

    def watch(report: Any) -> None:
        nonlocal iteration
        iteration = report.iteration + 1

    def slice_lane(self: _Run, x: Any) -> Any:
        on_device.append(isinstance(x, jax.Array) and iteration < 15)
        return original_slice(self, x)

    original, original_slice = _Run._part, _Run._of_lane
    monkeypatch.setattr(_Run, "_part", split)
    monkeypatch.setattr(_Run, "_of_lane", slice_lane)
    settings = TINY["ars"] | {"num_iterations": 16}
    cells = [
        one_device(point_mass, algorithm="ars", seeds=(seed,), settings=settings) for seed in (0, 1)
    ]
    execute_stack(cells, [tmp_path / "a", tmp_path / "b"], tmp_path / "stack", watch=watch)
    assert set(splits).isdisjoint({5, 7, 10, 11, 13, 14})  # others are milestones, or saved
    assert 12 in splits
    assert not any(on_device)  # before the checkpoint of each run, at the end


def test_what_cannot_be_stacked(point_mass: PointMass, point_mass_expert: Demonstrations) -> None:
    def key(expert: Demonstrations = point_mass_expert, **changes: Any) -> Any:
        settings = TINY["ailsrs"] | {"gradient_penalty": 1.0} | changes
        return stack_key(plan(RunSpec(point_mass, expert, settings=settings)))

    assert key() == key(gradient_penalty=2.0, step_size=1.0)
    assert key() == key(point_mass_expert.first(2))
    others = [
        key(gradient_penalty=0.0),
        key(num_directions=8),
        key(discriminator_loss="cross_entropy"),
        key(behavior_cloning_start=False),
        key(point_mass_expert.subsample(2)),
        key(
            point_mass_expert.replace(
                observations=point_mass_expert.observations[:, :20],
                actions=point_mass_expert.actions[:, :20],
                lengths=np.full(8, 20),
            )
        ),
    ]
    assert len({key(), *others}) == 7
