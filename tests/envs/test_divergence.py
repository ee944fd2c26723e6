"""Detection of divergence; MuJoCo does not reset diverging simulations."""

import re
from pathlib import Path

import gymnasium
import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ailsrs_jax.envs import State
from ailsrs_jax.envs.divergence import LARGEST, has_diverged
from ailsrs_jax.envs.physics import make_physics
from ailsrs_jax.envs.physics.quiet import without_warnings
from ailsrs_jax.envs.tasks.half_cheetah import HalfCheetah
from tests.exploding import STIFF_SLIDER

numbers = st.one_of(st.floats(-1e3, 1e3, width=32), st.floats(width=32))


@settings(max_examples=100, deadline=None)
@given(
    before=st.lists(numbers, min_size=2, max_size=2),
    action=st.lists(numbers, min_size=1, max_size=1),
    after=st.lists(numbers, min_size=2, max_size=2),
    reward=numbers,
)
def test_nan_and_large_numbers_count_as_diverged(before, action, after, reward) -> None:
    states = (
        State(None, jnp.float32(obs), jnp.float32(reward), jnp.zeros(())) for obs in (before, after)
    )
    state, next_state = states
    all_numbers = np.array([*before, *action, *after, reward])
    expected = not (np.isfinite(all_numbers).all() and np.abs(all_numbers).max() <= LARGEST)
    assert bool(has_diverged(state, jnp.float32(action), next_state)) == expected


def test_diverging_simulations_are_not_reset(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In Gymnasium an exploding cheetah returns to its initial pose, and the episode goes on."""
    monkeypatch.chdir(tmp_path)
    assert gymnasium.__file__ is not None
    model = Path(gymnasium.__file__).parent / "envs" / "mujoco" / "assets" / "half_cheetah.xml"
    path = tmp_path / "strong_cheetah.xml"
    path.write_text(re.sub(r'gear="(\d+)"', r'gear="\g<1>0000000"', model.read_text()))
    env = HalfCheetah("mujoco", xml_file=str(path))
    step = jax.jit(env.step)
    state = jax.jit(env.reset)(jax.random.key(0))
    with without_warnings():
        theirs = gymnasium.make("HalfCheetah-v5", xml_file=str(path)).unwrapped
        theirs.reset()
        theirs.set_state(*map(np.float64, (state.pipeline_state.qpos, state.pipeline_state.qvel)))
        action = np.ones(6, np.float32)
        diverged = []
        for _ in range(8):
            before, state = state, step(state, action)
            diverged.append(bool(has_diverged(before, action, state)))
            observation, *_ = theirs.step(action)
            assert np.isfinite(observation).all()
    assert theirs.data.time < 7 * env.dt  # Gymnasium's simulation was reset;
    assert any(diverged)  # ours is reported as diverged,
    assert all(diverged[diverged.index(True) :])  # and stays so
    assert not (tmp_path / "MUJOCO_LOG.TXT").exists()


@pytest.mark.parametrize("readings", [(), ("cfrc_ext",)])
def test_unstable_simulations_become_nan(readings: tuple[str, ...]) -> None:
    """In both ways of the C engine to step; other simulations of the batch go on."""
    model = mujoco.MjModel.from_xml_string(STIFF_SLIDER)
    physics = make_physics("mujoco", model, 4, readings)
    assert not model.opt.disableflags  # the caller's model is unchanged

    def simulate(position: jax.Array) -> jax.Array:
        state = physics.init(position[None], jnp.zeros(1))
        steps = jax.lax.scan(
            lambda state, _: (physics.step(state, jnp.ones(1), jnp.array(True)), state.qpos),
            state,
            length=20,
        )
        return steps[1][:, 0]

    inside, outside = jax.jit(jax.vmap(simulate))(jnp.array([0.1, 0.4]))
    assert np.isfinite(inside).all()
    assert float(inside[-1]) > float(inside[0])
    finite = np.isfinite(outside)
    assert not finite[-1]
    assert (np.diff(finite.astype(int)) <= 0).all()  # NaN from then on
    assert np.abs(outside[finite]).max() <= mujoco.mjMAXVAL
