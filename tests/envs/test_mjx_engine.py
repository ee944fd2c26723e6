import jax
import jax.numpy as jnp
import numpy as np
import pytest
from mujoco import mjx

from ailsrs_jax.envs.registry import make_env


@pytest.mark.slow
def test_two_steps_are_those_of_mjx() -> None:
    """Checks the Runge-Kutta loop and the state carried from step to step."""
    engine = make_env("swimmer", "mjx").physics
    model, nv = mjx.put_model(engine.model), engine.model.nv
    qpos, qvel = 0.1 * jnp.arange(nv), jnp.linspace(-1.0, 1.0, nv)
    controls = jnp.array([[0.5, -1.0], [1.0, 0.2]])

    @jax.jit
    def ours() -> tuple[jax.Array, ...]:
        state, _ = jax.lax.scan(
            lambda state, ctrl: (engine.step(state, ctrl, jnp.array(True)), None),
            engine.init(qpos, qvel),
            controls,
        )
        return state.qpos, state.qvel, state.carry

    @jax.jit
    def theirs() -> tuple[jax.Array, ...]:
        data = mjx.make_data(engine.model).replace(qpos=qpos, qvel=qvel)
        data, _ = jax.lax.scan(
            lambda data, ctrl: (mjx.step(model, data.replace(ctrl=ctrl)), None),
            data,
            jnp.repeat(controls, engine.frame_skip, axis=0),
        )
        return data.qpos, data.qvel, data.qacc_warmstart

    for value, expected in zip(ours(), theirs(), strict=True):
        assert np.abs(expected).max() > 0.1
        np.testing.assert_allclose(value, expected, rtol=1e-4, atol=1e-4)
