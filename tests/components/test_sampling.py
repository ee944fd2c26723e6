import jax
import jax.numpy as jnp
import numpy as np

from ailsrs_jax.components.sampling import empty_memory, sample_steps


def test_steps_are_drawn_uniformly_from_live_ones() -> None:
    lengths = jnp.array([3, 0, 1, 6])
    episodes, times = jax.jit(sample_steps, static_argnums=2)(jax.random.key(0), lengths, 20_000)
    assert bool((times < lengths[episodes]).all())
    assert bool((times >= 0).all())
    counts = np.zeros((4, 6))
    np.add.at(counts, (np.asarray(episodes), np.asarray(times)), 1)
    live = np.arange(6) < np.asarray(lengths)[:, None]
    np.testing.assert_allclose(counts[live], 2000, rtol=0.1)


def test_memory_replaces_the_oldest_and_samples_what_is_filled() -> None:
    memory = empty_memory(slots=3, slot_size=4, width=1)
    seen = []
    for iteration in range(5):
        memory = memory.insert(jnp.full((4, 1), float(iteration)))
        drawn = memory.sample(jax.random.key(iteration), 200)
        seen.append(set(np.unique(drawn).tolist()))
    assert seen == [{0.0}, {0.0, 1.0}, {0.0, 1.0, 2.0}, {1.0, 2.0, 3.0}, {2.0, 3.0, 4.0}]
