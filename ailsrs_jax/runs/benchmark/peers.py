"""Other packages that step these tasks, measured for ``ailsrs benchmark``.

Each function returns environment steps per second, in the fastest configuration of its package.
"""

import functools
import time
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import numpy as np

from ailsrs_jax.envs.gymnasium_env import GymnasiumEnv
from ailsrs_jax.envs.physics.quiet import without_warnings
from ailsrs_jax.envs.registry import short_name
from ailsrs_jax.runs.policies import still_policy
from ailsrs_jax.trainers.parts.rollout import Simulator
from ailsrs_jax.versions import available_cores

SECONDS = 3.0  # how long a configuration of a vector environment is stepped
STEPS = 64_000  # in an epoch of Brax, whose speed does not depend on the episodes' length


def brax_ars(env_id: str, num_directions: int, episode_length: int) -> float:
    """Measure Brax's augmented random search on its own MJX task of this name, on all devices."""
    import brax.envs
    from brax.training.agents.ars import train as ars

    speeds: list[float] = []
    num_epochs = 3  # the first compiles
    num_devices = jax.local_device_count()
    while 2 * num_directions % num_devices:  # each device must get the same number
        num_devices -= 1
    episode_length = min(episode_length, max(STEPS // (2 * num_directions), 1))
    ars.train(
        brax.envs.get_environment(short_name(env_id), backend="mjx"),
        num_timesteps=num_epochs * 2 * num_directions * episode_length,
        episode_length=episode_length,
        max_devices_per_host=num_devices,
        number_of_directions=num_directions,
        top_directions=num_directions,
        normalize_observations=True,
        num_eval_envs=1,
        num_evals=num_epochs,
        progress_fn=lambda _, metrics: speeds.append(float(metrics["training/sps"])),
    )
    return max(speeds[1:])


def gymnasium_vector(env_id: str) -> float:
    """Measure Gymnasium's vector environment: a process for each core, or all in this process."""
    import gymnasium

    speeds = []
    with without_warnings():
        # Forked processes could inherit a lock that JAX holds.
        for mode, options in (("async", {"context": "spawn"}), ("sync", {})):
            envs = gymnasium.make_vec(
                env_id, available_cores(), vectorization_mode=mode, vector_kwargs=options
            )
            envs.reset(seed=0)
            step = functools.partial(envs.step, envs.action_space.sample())
            speeds.append(_rate(step, envs.num_envs))
            envs.close()
    return max(speeds)


def gymnasium_workers(env_id: str, num_directions: int, episode_length: int) -> float:
    """Measure whole episodes of linear policies that do nothing, in a process for each core."""
    env = GymnasiumEnv(env_id)
    still, simulator, num_episodes = still_policy(env), Simulator(env), 2 * num_directions
    steps, key = 0, jax.random.key(0)
    simulator.evaluate(still, key, num_episodes, 1)  # starts the processes
    started = time.perf_counter()
    while time.perf_counter() < started + SECONDS:
        key, start_key = jax.random.split(key)
        episodes = simulator.evaluate(still, start_key, num_episodes, episode_length)
        steps += int(episodes.env_steps)
    return steps / (time.perf_counter() - started)


def envpool(env_id: str) -> float:
    """Measure EnvPool with a thread for each core, synchronous or not, in several batch sizes."""
    import envpool as pool

    speeds = []
    for num_envs, batch_size in ((16, 16), (64, 64), (64, 32), (256, 128)):
        envs = pool.make(
            env_id,
            env_type="gymnasium",
            num_envs=num_envs,
            batch_size=batch_size,
            num_threads=available_cores(),
        )
        envs.async_reset()
        actions = np.stack([envs.action_space.sample() for _ in range(batch_size)])

        def step(envs: Any = envs, actions: np.ndarray = actions) -> None:
            *_, info = envs.recv()
            envs.send(actions, info["env_id"])

        speeds.append(_rate(step, batch_size))
        envs.close()
    return max(speeds)


def _rate(step: Callable[[], Any], steps_in_a_call: int) -> float:
    for _ in range(10):
        step()
    calls, started = 0, time.perf_counter()
    while time.perf_counter() < started + SECONDS:
        step()
        calls += 1
    return calls * steps_in_a_call / (time.perf_counter() - started)


class Peer(NamedTuple):
    """A package to compare with."""

    package: str
    physics: str
    #: takes the task, the number of directions and the length of an episode
    measure: Callable[[str, int, int], float]


PEERS = {
    "brax_ars": Peer("brax", "mjx", brax_ars),
    "gymnasium": Peer("gymnasium", "mujoco", lambda env_id, *_: gymnasium_vector(env_id)),
    "gymnasium_workers": Peer("gymnasium", "mujoco", gymnasium_workers),
    "envpool": Peer("envpool", "mujoco", lambda env_id, *_: envpool(env_id)),
}
