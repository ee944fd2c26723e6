import importlib
import re
import sys
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from brax.envs.wrappers import training

from ailsrs_jax.envs.physics import choose_engine
from ailsrs_jax.envs.registry import make_env, open_env, require_harmless, resolve_env_id
from ailsrs_jax.errors import UserError
from tests.point_mass import PointMass


@pytest.mark.parametrize("name", ["Hopper-v5", "hopper"])
def test_a_task_has_two_names(name: str) -> None:
    assert resolve_env_id(name) == "Hopper-v5"


@pytest.mark.parametrize("name", ["", "hoper", "Hopper-v4", "../Hopper-v5"])
def test_unknown_names_are_refused_with_the_known_ones(name: str) -> None:
    with pytest.raises(UserError, match="ant, halfcheetah, hopper, humanoid, swimmer, walker2d"):
        resolve_env_id(name)


def test_auto_is_the_c_engine_without_an_accelerator() -> None:
    engine, reason = choose_engine("auto")
    assert engine == "mujoco"
    assert "no accelerator" in reason
    assert make_env("swimmer").backend == "mujoco"


def test_wrong_engines_flags_and_models_are_refused(tmp_path) -> None:
    with pytest.raises(UserError, match="unknown physics 'bullet'"):
        make_env("hopper", "bullet")
    with pytest.raises(UserError, match="Hopper-v5 has no flag gravity"):
        make_env("hopper", gravity=0.0)
    with pytest.raises(UserError, match="has no body 'head'"):
        make_env("ant", main_body="head")
    with pytest.raises(UserError, match="no model file"):
        make_env("hopper", xml_file=str(tmp_path / "none.xml"))
    broken = tmp_path / "broken.xml"
    broken.write_text("<mujoco><worldbody></mujoco>")
    with pytest.raises(UserError, match="cannot read"):
        make_env("hopper", xml_file=str(broken))


MODEL = """
<mujoco>
  <worldbody>
    <body>
      <joint name="slide" type="slide" axis="1 0 0"/>
      <geom size="0.1" mass="1"/>
    </body>
  </worldbody>
  <actuator>
    <general joint="slide" {actuator}/>
  </actuator>
</mujoco>
"""

TASKS_OF_ONES_OWN = """
from ailsrs_jax import MujocoTask
from tests.point_mass import PointMass

class Slider(MujocoTask):
    def __init__(self, physics, xml_file="./slider.xml"):
        super().__init__(physics=physics, xml_file=xml_file, frame_skip=2, reset_noise_scale=0.1,
                         num_hidden_positions=0)

    def _reward_terms(self, before, after, action):
        return {"reward_near": -abs(after.qpos[0]), "reward_ctrl": -(action**2).sum()}

class inside:
    point_mass = PointMass

def broken():
    raise KeyError("no\\nsuch key")

def nothing():
    return None

number = 3
"""


@pytest.fixture
def own_tasks(in_tmp_path: Path) -> None:
    Path("own_tasks.py").write_text(TASKS_OF_ONES_OWN)
    Path("slider.xml").write_text(MODEL.format(actuator='ctrlrange="-1 1"'))
    Path("syntax.py").write_text("class:")


@pytest.mark.usefixtures("own_tasks")
def test_your_own_task_by_module_and_attribute() -> None:
    for engine in ("mjx", "mujoco"):
        task = open_env("own_tasks:Slider", engine)
        assert task[1:] == ("own_tasks:Slider", engine, "as requested")
    assert "no accelerator" in open_env("own_tasks:Slider").reason
    task = open_env("own_tasks:inside.point_mass")
    assert task[1:] == ("own_tasks:inside.point_mass", "none", "the environment's own")
    with pytest.raises(UserError, match=r"no model file elsewhere\.xml"):
        make_env("own_tasks:Slider", xml_file="./elsewhere.xml")


def test_an_environment_instead_of_a_name() -> None:
    env = PointMass()
    assert open_env(env) == (env, "PointMass", "none", "the environment's own")
    assert open_env(training.EpisodeWrapper(env, 5, 1)).env_id == "PointMass"


def test_a_task_that_was_made_keeps_its_name() -> None:
    """So it has the task's preset, expert and demonstrations; with other flags it is another."""
    made = make_env("swimmer", "mujoco")
    assert open_env(made).env_id == "Swimmer-v5"
    assert open_env(make_env("swimmer", "mujoco", frame_skip=5)).env_id == "Swimmer"
    assert open_env(training.EpisodeWrapper(made, 5, 1)).env_id == "Swimmer"


@pytest.mark.parametrize(
    ("flags", "problem"),
    [
        ({"frame_skip": 2.5}, "frame_skip is 2.5: it must be a whole number from 1"),
        ({"frame_skip": -1}, "frame_skip is -1"),
        ({"reset_noise_scale": -0.1}, "reset_noise_scale is -0.1: it must not be negative"),
    ],
)
def test_flags_that_make_no_sense_are_refused(flags: dict[str, Any], problem: str) -> None:
    with pytest.raises(UserError, match=re.escape(problem)):
        make_env("swimmer", "mujoco", **flags)


def test_an_environment_of_gymnasium_is_not_made_here() -> None:
    with pytest.raises(UserError, match="has no step and reset in JAX: pass its name to train"):
        make_env("gymnasium:Pendulum-v1")


@pytest.mark.usefixtures("own_tasks")
def test_an_environment_is_built_once_until_its_module_changes() -> None:
    first = open_env("own_tasks:Slider").env
    assert open_env("own_tasks:Slider").env is first
    importlib.reload(sys.modules["own_tasks"])
    assert open_env("own_tasks:Slider").env is not first


REFUSED = {
    "nowhere:Slider": "cannot find nowhere:Slider: there is no module nowhere here",
    "syntax:Slider": "SyntaxError",
    ":Slider": "cannot import :Slider: .py, line 1: ValueError",
    "sys:Slider": "sys, line 1: there is no 'Slider'",
    "own_tasks:Glider": "own_tasks.py, line 1: there is no 'Glider' (did you mean Slider?)",
    "own_tasks:": "own_tasks.py, line 1: there is no ''",
    "own_tasks:number": "3 is not a callable object",
    "own_tasks:broken": "own_tasks:broken: KeyError: 'no",
    "own_tasks:nothing": "NoneType: this is not a Brax environment",
    "own_tasks:MujocoTask": "own_tasks:MujocoTask: TypeError",
}


@pytest.mark.usefixtures("own_tasks")
@pytest.mark.parametrize(("name", "message"), REFUSED.items())
def test_wrong_names_are_refused(name: str, message: str) -> None:
    with pytest.raises(UserError) as caught:
        open_env(name)
    assert message in str(caught.value)


@pytest.mark.usefixtures("own_tasks")
def test_physics_can_only_be_chosen_where_there_is_a_choice() -> None:
    with pytest.raises(UserError, match="has no parameter physics: leave 'mjx' out"):
        open_env("own_tasks:inside.point_mass", "mjx")
    with pytest.raises(UserError, match="an environment has its own"):
        open_env(PointMass(), "mjx")
    with pytest.raises(UserError, match="unknown physics 'bullet'"):
        open_env("own_tasks:inside.point_mass", "bullet")


@pytest.mark.usefixtures("own_tasks")
def test_an_actuator_needs_a_range() -> None:
    Path("slider.xml").write_text(MODEL.format(actuator=""))
    with pytest.raises(UserError, match="every actuator a ctrlrange"):
        open_env("own_tasks:Slider")


@pytest.mark.usefixtures("own_tasks")
def test_actuators_with_a_state_need_the_c_engine() -> None:
    actuator = 'ctrlrange="-1 1" dyntype="integrator" actlimited="true" actrange="-1 1"'
    Path("slider.xml").write_text(MODEL.format(actuator=actuator))
    with pytest.raises(UserError, match="use physics mujoco"):
        make_env("own_tasks:Slider", "mjx")
    env = make_env("own_tasks:Slider", "mujoco")
    state = env.reset(jax.random.key(0))
    for _ in range(3):
        velocity, state = state.obs[1], env.step(state, jnp.ones(1))
    # Two steps of 2 ms each time; the integrated control is the force on a kilogram.
    np.testing.assert_allclose(state.obs[1] - velocity, 0.002 * (0.008 + 0.010), rtol=0.01)


@pytest.mark.usefixtures("own_tasks")
def test_harmful_names_in_files_are_not_imported() -> None:
    open_env("own_tasks:Slider")  # the user names it
    for env_id in ("Hopper-v5", "own_tasks:Slider", "PointMass", "gymnasium:Pusher-v5"):
        require_harmless(env_id, "policy.npz")
    for env_id in (
        *("os:abort", "numpy.f2py.__main__:x", "../x:y", ":", "a b:c", "own_tasks:make_glider"),
        *("gymnasium:own_tasks:Mine-v0", "gymnasium:Nothing-v0", "gymnasium:"),
    ):
        with pytest.raises(UserError, match=r"policy\.npz names .* not imported.*--env"):
            require_harmless(env_id, "policy.npz")
