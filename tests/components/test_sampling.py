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
    memory = empty_memory(slots=3, num_pairs=2, steps_each=4, width=1, num_here=2)
    seen = []
    for iteration in range(5):
        memory = filled(memory, float(iteration), [3, 1, 4, 1])
        drawn, here = memory.sample(jax.random.key(iteration), 200)
        assert bool(here.all())
        seen.append(set(np.unique(drawn).tolist()))
    assert seen == [{0.0}, {0.0, 1.0}, {0.0, 1.0, 2.0}, {1.0, 2.0, 3.0}, {2.0, 3.0, 4.0}]


def test_memory_draws_an_episode_as_often_as_it_is_long() -> None:
    memory = empty_memory(slots=2, num_pairs=2, steps_each=5, width=1, num_here=2)
    lengths = jnp.array([[30, 1], [7, 62]])
    steps = jnp.arange(20.0).reshape(2, 2, 5, 1)  # a number for each remembered step
    drawn, _ = memory.insert(steps, lengths).sample(jax.random.key(0), 100_000)
    shares = np.bincount(np.asarray(drawn[:, 0], int), minlength=20) / 100_000
    np.testing.assert_allclose(
        shares.reshape(4, 5).sum(axis=1), [0.30, 0.01, 0.07, 0.62], atol=0.01
    )
    np.testing.assert_allclose(shares[:5], 0.06, atol=0.005)  # each of those remembered as often


def test_parts_of_a_memory_hold_the_draws_of_the_whole() -> None:
    lengths = jax.random.randint(jax.random.key(0), (2, 6), 1, 50)
    steps = jax.random.normal(jax.random.key(1), (2, 6, 3, 4))
    whole = empty_memory(2, num_pairs=6, steps_each=3, width=4, num_here=6).insert(steps, lengths)
    expected, _ = whole.sample(jax.random.key(2), 100)
    together = jnp.zeros_like(expected)
    for first in (0, 2, 4):
        part = empty_memory(2, num_pairs=6, steps_each=3, width=4, num_here=2)
        part = part.insert(steps[:, first : first + 2], lengths)
        drawn, here = part.sample(jax.random.key(2), 100, first)
        together = together + jnp.where(here[:, None], drawn, 0.0)
    np.testing.assert_array_equal(together, expected)
