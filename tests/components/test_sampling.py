import jax
import jax.numpy as jnp
import numpy as np

from ailsrs_jax.components.sampling import StepMemory, empty_memory, sample_steps


def test_steps_are_drawn_uniformly_from_live_ones() -> None:
    lengths = jnp.array([3, 0, 1, 6])
    episodes, times = jax.jit(sample_steps, static_argnums=2)(jax.random.key(0), lengths, 20_000)
    assert bool((times < lengths[episodes]).all())
    assert bool((times >= 0).all())
    counts = np.zeros((4, 6))
    np.add.at(counts, (np.asarray(episodes), np.asarray(times)), 1)
    live = np.arange(6) < np.asarray(lengths)[:, None]
    np.testing.assert_allclose(counts[live], 2000, rtol=0.1)


def filled(memory: StepMemory, value: float, lengths: list[int]) -> StepMemory:
    steps = jnp.full(memory.steps.shape[1:], value)
    return memory.insert(steps, jnp.array(lengths).reshape(2, -1))


def test_memory_replaces_the_oldest_and_samples_what_is_filled() -> None:
    memory = empty_memory(slots=3, num_pairs=2, steps_each=4, width=1)
    seen = []
    for iteration in range(5):
        memory = filled(memory, float(iteration), [3, 1, 4, 1])
        drawn = memory.sample(jax.random.key(iteration), 200)
        seen.append(set(np.unique(drawn).tolist()))
    assert seen == [{0.0}, {0.0, 1.0}, {0.0, 1.0, 2.0}, {1.0, 2.0, 3.0}, {2.0, 3.0, 4.0}]


def test_memory_draws_an_episode_as_often_as_it_is_long() -> None:
    memory = empty_memory(slots=2, num_pairs=2, steps_each=5, width=1)
    lengths = jnp.array([[30, 1], [7, 62]])
    steps = jnp.arange(20.0).reshape(2, 2, 5, 1)  # a number for each remembered step
    drawn = memory.insert(steps, lengths).sample(jax.random.key(0), 100_000)
    shares = np.bincount(np.asarray(drawn[:, 0], int), minlength=20) / 100_000
    np.testing.assert_allclose(
        shares.reshape(4, 5).sum(axis=1), [0.30, 0.01, 0.07, 0.62], atol=0.01
    )
    np.testing.assert_allclose(shares[:5], 0.06, atol=0.005)  # each of those remembered as often
