"""The names of what tasks observe."""

import pytest

from ailsrs_jax.envs.registry import TASKS, make_env
from ailsrs_jax.envs.tasks.entry_names import action_names, observation_names


@pytest.mark.parametrize("env_id", TASKS)
def test_each_number_has_a_name_of_its_own(env_id: str) -> None:
    task = make_env(env_id, "mujoco")
    for names, size in (
        (observation_names(task), task.observation_size),
        (action_names(task), task.action_size),
    ):
        assert len(names) == len(set(names)) == size


def test_names_are_those_of_the_joints() -> None:
    hopper, ant = (make_env(name, "mujoco") for name in ("hopper", "ant"))
    joints = ["rootz", "rooty", "thigh_joint", "leg_joint", "foot_joint"]
    speeds = [f"{joint} velocity" for joint in ("rootx", *joints)]
    assert observation_names(hopper) == [*joints, *speeds]
    assert action_names(hopper) == joints[2:]
    assert observation_names(ant)[:6] == [
        "root z",
        "root q0",
        "root q1",
        "root q2",
        "root q3",
        "hip_1",
    ]
    assert observation_names(ant)[13:19] == [
        f"root {part}" for part in ("vx", "vy", "vz", "wx", "wy", "wz")
    ]
    assert observation_names(ant)[27] == "cfrc_ext 6"  # the world's body is not observed
    assert action_names(ant)[0] == "hip_4"
