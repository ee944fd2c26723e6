"""A plan, and the command line that makes its run again."""

import shlex
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest

from ailsrs_jax.data.demonstrations import Demonstrations, save_demonstrations
from ailsrs_jax.data.sources import Source
from ailsrs_jax.errors import UserError
from ailsrs_jax.runs.plan import plan
from ailsrs_jax.runs.spec import RunSpec
from ailsrs_jax.runs.training_data import NUM_TRAJECTORIES
from tests.point_mass import PointMass
from tests.runs.test_run import swimmer_demonstrations

RANDOM_SEARCH = "ailsrs train swimmer --algorithm ars --seeds 0 3"
COMMANDS: dict[str, dict[str, Any]] = {
    f"{RANDOM_SEARCH} --physics mujoco": {"algorithm": "ars"},
    f"{RANDOM_SEARCH} --preset paper --physics mjx": {
        "algorithm": "ars",
        "preset": "paper",
        "physics": "mjx",
        "env": "Swimmer-v5",
    },
    f"{RANDOM_SEARCH} --physics mujoco --rollout-batch-size 3 "
    "--set noise_std=0.05 normalize_observations=false": {
        "algorithm": "ars",
        "rollout_batch_size": 3,
        "settings": {"noise_std": 0.05, "normalize_observations": False, "episode_length": 1000},
    },
    "ailsrs train swimmer --demonstrations 'my demos.npz' --num-trajectories 2 --subsample 4 "
    "--seeds 0 3 --physics mujoco": {
        "demonstrations": Path("my demos.npz"),
        "num_trajectories": 2,
        "subsample": 4,
    },
    "ailsrs train swimmer --demonstrations 'my demos.npz' --num-trajectories 2 --states-only "
    "--seeds 0 3 --physics mujoco": {
        "demonstrations": Path("my demos.npz"),
        "num_trajectories": 2,
        "states_only": True,
    },
}


@pytest.mark.parametrize(("command", "fields"), COMMANDS.items())
def test_the_command_names_what_is_not_a_default(
    command: str, fields: dict[str, Any], in_tmp_path: Path
) -> None:
    save_demonstrations(swimmer_demonstrations(), "my demos.npz")
    spec = RunSpec(**({"env": "swimmer", "seeds": (0, 3), "physics": "mujoco"} | fields))
    assert plan(spec).spec.command == command


def test_64_bits_are_refused() -> None:
    with jax.enable_x64(True), pytest.raises(UserError, match="only 32 bits are supported"):
        plan(RunSpec("hopper", algorithm="ars"))


def test_auto_physics_is_decided(point_mass: PointMass, in_tmp_path: Path) -> None:
    made = plan(RunSpec("hopper", algorithm="ars"))
    assert f"--physics {made.config.physics}" in str(made.spec.command)
    own = plan(RunSpec("tests.point_mass:PointMass", algorithm="ars"))
    assert own.spec.command == "ailsrs train tests.point_mass:PointMass --algorithm ars --seeds 0"


def test_objects_have_no_command(point_mass: PointMass) -> None:
    assert plan(RunSpec(point_mass, algorithm="ars")).spec.command is None
    spec = RunSpec("swimmer", swimmer_demonstrations(), physics="mujoco")
    made = plan(spec)
    assert made.spec.command is None
    assert made.config.source == Source("memory")


@pytest.mark.parametrize("expert", [None, "paper", "linear"])
def test_the_shipped_expert_is_a_source(
    expert: str | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[Any] = []

    def roll_out(env_id: str, number: int, engine: str, name: str | None) -> Demonstrations:
        asked.append((env_id, number, engine, name))
        return Demonstrations(
            observations=np.zeros((number, 10, 17), np.float32),
            actions=np.zeros((number, 10, 6), np.float32),
            lengths=np.full(number, 10),
            returns=np.ones(number, np.float32),
            env_id=env_id,
        )

    monkeypatch.setattr("ailsrs_jax.runs.training_data.expert_demonstrations", roll_out)
    argument = f"expert:{expert}" if expert else None
    made = plan(RunSpec("walker2d", argument, physics="mujoco"))
    assert asked == [("Walker2d-v5", NUM_TRAJECTORIES, "mujoco", expert)]
    assert made.config.source == Source("expert", expert)
    assert made.config.source.argument == argument
    words = shlex.split(str(made.spec.command))
    assert [word for word in words if word.startswith("expert:")] == ([argument] if expert else [])
    assert made.config.num_trajectories == NUM_TRAJECTORIES


@pytest.mark.parametrize(
    ("argument", "problem"),
    [
        ({"seeds": [0.5]}, "seeds are not a list of whole numbers"),
        ({"seeds": 3}, "seeds are not a list of whole numbers"),
        ({"num_trajectories": 2.5}, "num_trajectories is 2.5, not a whole number"),
        ({"subsample": "4"}, "subsample is '4', not a whole number"),
    ],
)
def test_numbers_are_whole(argument: dict[str, Any], problem: str) -> None:
    with pytest.raises(UserError, match=problem):
        plan(RunSpec("hopper", **argument))


def test_numbers_may_be_numpys(point_mass: PointMass, point_mass_expert: Demonstrations) -> None:
    numbers = {"seeds": np.arange(2), "num_trajectories": np.int64(2)}
    made = plan(RunSpec(point_mass, point_mass_expert, **numbers))
    assert made.config.as_json()["seeds"] == [0, 1]


def test_a_seed_can_draw_its_own_episodes(
    point_mass: PointMass, point_mass_expert: Demonstrations
) -> None:
    count = point_mass_expert.num_trajectories
    assert count >= 4

    def drawn(**fields: Any) -> Demonstrations:
        fields = {"num_trajectories": 2, "draw_from": count, "seeds": [3]} | fields
        planned = plan(RunSpec(point_mass, point_mass_expert, **fields))
        assert planned.data.demonstrations is not None
        # A seed that draws a bad episode is not better than the expert for it.
        np.testing.assert_array_equal(planned.data.expert_returns, point_mass_expert.returns)
        return planned.data.demonstrations

    order = np.random.default_rng(3).permutation(count)[:2]
    np.testing.assert_array_equal(drawn().lengths, point_mass_expert.lengths[order])
    np.testing.assert_array_equal(drawn().observations, point_mass_expert.observations[order])
    every, other = (drawn(subsample=4, seeds=[seed]).observations for seed in (3, 4))
    assert not np.array_equal(every, other)
    with pytest.raises(UserError, match="num_trajectories is 9999"):
        drawn(num_trajectories=9999)
    with pytest.raises(UserError, match="draw_from is for a single seed"):
        drawn(seeds=[0, 1])
    with pytest.raises(UserError, match="leave out demonstrations, num_trajectories, draw_from"):
        plan(RunSpec(point_mass, algorithm="ars", draw_from=3))
