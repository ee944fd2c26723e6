import pytest

from ailsrs_jax.envs.physics import choose_engine
from ailsrs_jax.envs.registry import make_env, resolve_env_id
from ailsrs_jax.errors import UserError


@pytest.mark.parametrize("name", ["Hopper-v5", "hopper"])
def test_a_task_has_two_names(name: str) -> None:
    assert resolve_env_id(name) == "Hopper-v5"


@pytest.mark.parametrize("name", ["", "hoper", "Hopper-v4", "../Hopper-v5"])
def test_unknown_names_are_refused_with_the_known_ones(name: str) -> None:
    with pytest.raises(UserError, match="halfcheetah, hopper, swimmer, walker2d"):
        resolve_env_id(name)


def test_auto_is_the_c_engine_without_an_accelerator() -> None:
    engine, reason = choose_engine("auto")
    assert engine == "mujoco"
    assert "no accelerator" in reason
    assert make_env("swimmer").backend == "mujoco"


def test_wrong_engine_flag_and_model_are_the_users_mistakes(tmp_path) -> None:
    with pytest.raises(UserError, match="unknown physics 'bullet'"):
        make_env("hopper", "bullet")
    with pytest.raises(UserError, match="gravity"):
        make_env("hopper", gravity=0.0)
    with pytest.raises(UserError, match="no model file"):
        make_env("hopper", xml_file=str(tmp_path / "none.xml"))
    broken = tmp_path / "broken.xml"
    broken.write_text("<mujoco><worldbody></mujoco>")
    with pytest.raises(UserError, match="cannot read"):
        make_env("hopper", xml_file=str(broken))
