"""Behaviour cloning of a Gaussian policy whose mean is a multilayer perceptron."""

import jax
import jax.numpy as jnp
import optax

from ailsrs_jax.components import trust_region
from ailsrs_jax.components.descent import descend
from ailsrs_jax.components.policy import Layers, perceptron
from ailsrs_jax.components.sampling import sample_steps
from ailsrs_jax.trainers.parts.reference import Reference

BATCH_SIZE = 128


def draw_layers(key: jax.Array, sizes: tuple[int, ...], final_scale: float = 1.0) -> Layers:
    """Draw a network with orthogonal weights and biases of zero.

    ``sizes`` are those of its layers, from the input's to the output's. The weights of the last
    layer have the scale ``final_scale``, those of the others 1.
    """
    keys = jax.random.split(key, len(sizes) - 1)
    scales = [1.0] * (len(sizes) - 2) + [final_scale]
    weights = tuple(
        jax.nn.initializers.orthogonal(scale)(key, (outputs, inputs))
        for key, scale, inputs, outputs in zip(keys, scales, sizes[:-1], sizes[1:], strict=True)
    )
    return weights, tuple(jnp.zeros(size) for size in sizes[1:])


def clone_network(
    layers: Layers,
    log_std: jax.Array,
    expert: Reference,
    key: jax.Array,
    *,
    num_steps: int,
    learning_rate: optax.ScalarOrSchedule,
) -> tuple[Layers, jax.Array]:
    """Make the expert's actions the most likely ones, by ``num_steps`` of Adam.

    Maximising the likelihood, not only minimising the squared error, also fits the standard
    deviation to the error of the mean. With a standard deviation of one, noise would hide the
    clone.

    Returns:
        The trained layers and the trained logarithm of the standard deviation ``(p,)``.
    """
    adam = optax.adam(learning_rate)

    def loss(parameters: tuple[Layers, jax.Array], key: jax.Array) -> tuple[jax.Array, None]:
        layers, log_std = parameters
        episode, time = sample_steps(key, expert.lengths, BATCH_SIZE)
        means = perceptron(*layers, expert.observations[episode, time])
        taken = expert.actions[episode, time]
        return -trust_region.gaussian_log_density(taken, means, log_std).mean(), None

    start = layers, log_std
    cloned, *_ = descend(adam, loss, start, adam.init(start), jax.random.split(key, num_steps))
    return cloned
