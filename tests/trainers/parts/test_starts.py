import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ailsrs_jax.data.demonstrations import Demonstrations
from ailsrs_jax.envs.registry import TASKS, make_env
from ailsrs_jax.trainers.parts.reference import Reference, make_reference
from ailsrs_jax.trainers.parts.starts import draw_starts


def reference_of(observations: np.ndarray, lengths: list[int]) -> Reference:
    num_episodes, num_steps, _ = observations.shape
    demonstrations = Demonstrations(
        observations=observations.astype(np.float32),
        actions=np.zeros((num_episodes, num_steps, 1), np.float32),
        lengths=np.array(lengths),
        returns=np.zeros(num_episodes, np.float32),
        env_id="noise",
    )
    return make_reference(demonstrations, num_steps, 10)


@pytest.mark.parametrize("env_id", TASKS)
def test_the_state_of_an_observation_makes_it_again(env_id: str) -> None:
    env = make_env(env_id, "mujoco")
    state = env.reset(jax.random.key(0))
    for action in jax.random.uniform(jax.random.key(1), (3, env.action_size), minval=-0.3):
        state = env.step(state, action)
    num_numbers = env.physics.model.nq + env.physics.model.nv - env._num_hidden_positions
    again = env.start(env.state_at(state.obs))
    # Forces and velocities of bodies are those of the last step, which a start does not have.
    np.testing.assert_allclose(again.obs[:num_numbers], state.obs[:num_numbers], atol=1e-6)


def test_starts_are_resets_and_demonstrated_states_in_the_share_asked_for() -> None:
    env = make_env("swimmer", "mujoco")
    observations = 10.0 + np.arange(2 * 3 * 8).reshape(2, 3, 8)
    reference = reference_of(observations, [3, 2])
    draw = jax.jit(draw_starts, static_argnums=(0, 3))
    counts, angles = [], set()
    for seed in range(40):
        starts = draw(env, reference, jax.random.key(seed), 5, jnp.float32(0.5))
        demonstrated = np.asarray(starts.qpos[:, 2]) > 5.0  # resets are close to zero
        counts.append(int(demonstrated.sum()))
        angles |= set(np.asarray(starts.qpos[demonstrated, 2]).round(2).tolist())
        np.testing.assert_array_equal(starts.qpos[demonstrated, :2], 0.0)
    assert set(counts) == {2, 3}
    np.testing.assert_allclose(np.mean(counts), 2.5, atol=0.3)
    # Any live step is drawn, and no other.
    assert angles == {10.0, 18.0, 26.0, 34.0, 42.0}


def test_without_a_share_there_are_only_resets() -> None:
    env = make_env("swimmer", "mujoco")
    keys = draw_starts(env, reference_of(np.ones((1, 2, 8)), [2]), jax.random.key(0), 3, 0.0)
    np.testing.assert_array_equal(
        jax.random.key_data(keys).shape, jax.random.key_data(jax.random.split(keys[0], 3)).shape
    )


def test_an_environment_that_cannot_be_put_into_a_state_is_reset(point_mass: object) -> None:
    starts = draw_starts(
        point_mass, reference_of(np.ones((1, 2, 2)), [2]), jax.random.key(0), 3, 0.5
    )
    assert jnp.issubdtype(starts.dtype, jax.dtypes.prng_key)


def test_a_task_that_makes_its_observation_otherwise_is_reset() -> None:
    class Doubled(type(make_env("swimmer", "mujoco"))):  # type: ignore[misc]
        def _observation(self, physics_state):
            return 2.0 * super()._observation(physics_state)

    reference = reference_of(np.ones((1, 2, 8)), [2])
    starts = draw_starts(Doubled(physics="mujoco"), reference, jax.random.key(0), 3, 0.5)
    assert jnp.issubdtype(starts.dtype, jax.dtypes.prng_key)
