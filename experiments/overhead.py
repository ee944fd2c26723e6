"""What learning costs beside physics: time of each part of a training step, as a share of it.

usage: python experiments/overhead.py [ENV ...]    (N = 32 directions, T = 1000; on an idle machine)
"""

import dataclasses
import sys
import time
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from ailsrs_jax.components import normalizer, random_search
from ailsrs_jax.envs.registry import make_env, resolve_env_id
from ailsrs_jax.runs.demonstrate import expert_demonstrations
from ailsrs_jax.runs.presets import preset_settings
from ailsrs_jax.trainers.ailsrs import make_ailsrs
from ailsrs_jax.trainers.rollout import rollout

NUM_DIRECTIONS = 32
REPEATS = 3


def timed(function: Callable[..., Any], *arguments: Any) -> tuple[float, Any]:
    """Least seconds of a few calls after the one that compiles, and the result."""
    compiled = jax.jit(function)
    result = jax.block_until_ready(compiled(*arguments))
    seconds = []
    for _ in range(REPEATS):
        started = time.perf_counter()
        jax.block_until_ready(compiled(*arguments))
        seconds.append(time.perf_counter() - started)
    return min(seconds), result


def measure(env_id: str) -> dict[str, float]:
    """Seconds of each part, for one iteration at the start of a run."""
    env, n = make_env(env_id), NUM_DIRECTIONS
    settings = dataclasses.replace(
        preset_settings(env_id, "tuned"),
        num_directions=n,
        num_top_directions=n // 2,
        standardize_with="running",
    )
    trainer = make_ailsrs(env, expert_demonstrations(env_id, 10, "auto"), settings)
    state = jax.jit(trainer.init)(jax.random.key(0))
    policy = trainer.policy(state.weights, state.statistics)
    deltas = random_search.sample_directions(jax.random.key(1), n, state.weights.shape)
    unperturbed = jnp.tile(state.weights, (settings.num_evaluation_episodes, 1, 1))
    perturbed = random_search.perturb(state.weights, deltas, settings.noise_std)
    weights = jnp.concatenate([perturbed, unperturbed])
    keys = jax.random.split(jax.random.key(2), len(weights))

    parts: dict[str, float] = {}
    parts["rollout"], batch = timed(
        lambda weights: rollout(env, policy.with_weights(weights), keys, settings.episode_length),
        weights,
    )
    explored, evaluation = batch.episodes(0, 2 * n), batch.episodes(2 * n)
    parts["memory"], memory = timed(
        lambda episodes: state.memory.insert(trainer._sample_inputs(jax.random.key(3), episodes)),
        explored,
    )
    parts["discriminator"], _ = timed(
        lambda memory: trainer._train_discriminator(state, memory, jax.random.key(4)), memory
    )
    parts["scores"], returns = timed(
        lambda episodes: trainer._imitation_returns(state.discriminator, episodes), explored
    )
    parts["random search"], _ = timed(
        lambda returns: random_search.step(
            state.weights,
            deltas,
            returns[:n],
            returns[n:],
            step_size=settings.step_size,
            num_top_directions=n // 2,
        ),
        returns,
    )
    parts["statistics"], _ = timed(
        lambda e: normalizer.update(state.statistics, e.observations, e.alive), explored
    )
    parts["energy distance"], _ = timed(
        lambda episodes: trainer._distance_to_expert(jax.random.key(5), episodes), evaluation
    )
    return parts


def main() -> None:
    """Print a row per task."""
    for name in sys.argv[1:] or ["halfcheetah", "hopper", "swimmer", "walker2d"]:
        parts = measure(resolve_env_id(name))
        total = sum(parts.values())
        shares = ", ".join(f"{part} {100 * s / total:.1f} %" for part, s in parts.items())
        print(f"{name}: {total:.2f} s: {shares}")  # noqa: T201


if __name__ == "__main__":
    main()
