"""Behaviour cloning of a Gaussian policy whose mean is a multilayer perceptron."""

import jax
import jax.numpy as jnp
import optax

from ailsrs_jax.components import trust_region
from ailsrs_jax.components.descent import descend
from ailsrs_jax.components.policy import Layers, perceptron
from ailsrs_jax.components.sampling import sample_steps

BATCH_SIZE = 128


def draw_layers(key: jax.Array, sizes: tuple[int, ...], final_scale: float = 1.0) -> Layers:
    """Draw a network with orthogonal weights and biases of zero.

    Args:
        key: of the weights.
        sizes: of its layers, from the input's to the output's.
        final_scale: of the weights of the last layer, where those of the others have 1.
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
    key: jax.Array,
    *,
    observations: jax.Array,
    actions: jax.Array,
    lengths: jax.Array,
    num_steps: int,
    learning_rate: optax.ScalarOrSchedule,
) -> tuple[Layers, jax.Array]:
    """Make the expert's actions the most likely ones, by steps of Adam.

    Maximising the likelihood, not only minimising the squared error, also fits the standard
    deviation to the error of the mean. With a standard deviation of one, noise would hide the
    clone.

    Args:
        layers: of the mean, for standardised observations.
        log_std: ``(p,)`` the logarithm of the standard deviation.
        key: of the minibatches.
        observations: ``(E, T, n)`` of the expert, standardised.
        actions: ``(E, T, p)`` of the expert.
        lengths: ``(E,)`` how many first steps of each episode there are.
        num_steps: of Adam.
        learning_rate: of Adam.

    Returns:
        The trained layers and the trained logarithm of the standard deviation.
    """
    adam = optax.adam(learning_rate)

    def loss(parameters: tuple[Layers, jax.Array], key: jax.Array) -> tuple[jax.Array, None]:
        layers, log_std = parameters
        episode, time = sample_steps(key, lengths, BATCH_SIZE)
        means = perceptron(*layers, observations[episode, time])
        taken = actions[episode, time]
        return -trust_region.gaussian_log_density(taken, means, log_std).mean(), None

    start = layers, log_std
    cloned, *_ = descend(adam, loss, start, adam.init(start), jax.random.split(key, num_steps))
    return cloned
