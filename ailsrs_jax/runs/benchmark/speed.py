"""Measure the speed of bare physics, rollouts, training steps and installed peers."""

import concurrent.futures
import contextlib
import dataclasses
import multiprocessing
import os
import resource
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax
import mujoco.rollout
import numpy as np

from ailsrs_jax.components import random_search
from ailsrs_jax.data.demonstrations import Demonstrations
from ailsrs_jax.envs.physics import PhysicsState
from ailsrs_jax.envs.physics.mujoco_engine import available_cores
from ailsrs_jax.envs.registry import TASKS, make_env
from ailsrs_jax.envs.tasks.mujoco_task import MujocoTask
from ailsrs_jax.errors import UserError
from ailsrs_jax.runs.benchmark import peers
from ailsrs_jax.runs.devices import choose_simulator, set_up_jax
from ailsrs_jax.trainers.ailsrs import Ailsrs, TrainState, make_ailsrs
from ailsrs_jax.trainers.algorithms import preset_settings
from ailsrs_jax.trainers.parts.episodes import Episodes
from ailsrs_jax.trainers.parts.exploration import explore
from ailsrs_jax.trainers.parts.rollout import AXIS, Simulator


@dataclasses.dataclass(frozen=True)
class Row:
    """The speed of one stage."""

    env: str
    physics: str  # the engine, ours or the peer's
    stage: str  # bare, rollout, train or peer:NAME
    env_steps_per_s: float  # steps of episodes that have not ended; the median of the repeats
    compile_s: float | None
    peak_memory_mb: float  # of the measuring process or, if there is one, its accelerator
    utilization: float | None = None  # live steps / steps of the slots that simulated them


@dataclasses.dataclass(frozen=True)
class Measurement:
    """What one process measured."""

    rows: tuple[Row, ...]
    ratios: dict[str, float]  # ratios of speeds, by name
    problem: str = ""  # why a peer could not be measured


class Stage(NamedTuple):
    """A compiled program to measure."""

    call: Callable[[], Any]
    live_steps: int  # in a call
    compile_s: float


def benchmark(
    env_ids: Sequence[str],
    engines: Sequence[str],
    num_directions: int,
    episode_length: int,
    repeats: int,
) -> Iterator[Measurement]:
    """Measure every task on every engine and with every peer, each in its own process.

    Raises:
        UserError: a measurement failed that is not a peer's.
    """
    for env_id in env_ids:
        speeds: dict[str, float] = {}
        for engine in engines:
            arguments = (env_id, engine, num_directions, episode_length, repeats)
            measurement = _in_a_process(measure, *arguments)
            speeds[engine] = measurement.rows[-1].env_steps_per_s
            yield measurement
        for name, peer in peers.PEERS.items():
            if env_id not in TASKS or not peer.is_installed():
                continue
            try:
                row = _in_a_process(measure_peer, name, env_id, num_directions, episode_length)
            except UserError as error:  # a peer that fails does not end the benchmark
                yield Measurement((), {}, str(error))
                continue
            ratios = {
                f"{env_id} {engine} train / {row.stage}": speed / row.env_steps_per_s
                for engine, speed in speeds.items()
            }
            yield Measurement((row,), ratios)


def measure(
    env_id: str, engine: str, num_directions: int, episode_length: int, repeats: int
) -> Measurement:
    """Measure bare physics, the rollout and the training step of a task on an engine, in turns.

    All three simulate the first iteration of the paper's preset, from weights of zero. Ratios
    compare speeds of the same turn. Bare physics replays the rollout's actions from the same
    initial states, one environment step in a call, without policies, observations, rewards or ends
    of episodes.
    """
    set_up_jax()
    env = make_env(env_id, engine)
    settings = dataclasses.replace(
        preset_settings(env_id, "paper"),
        num_directions=num_directions,
        num_top_directions=num_directions,
        episode_length=episode_length,
        behavior_cloning_start=False,
    )
    simulator = _shared_evenly(choose_simulator(env), 2 * num_directions)
    trainer = make_ailsrs(simulator, _demonstrations(env), settings)
    state = jax.jit(trainer.init)(jax.random.key(0))
    noise_key, reset_key = jax.random.split(jax.random.key(1))
    rollout, rollout_compile_s = _compile(_rollout(trainer, state, noise_key, reset_key))
    update, update_compile_s = _compile(trainer.update, state)
    episodes = rollout()
    bare, bare_compile_s = _bare(simulator, np.asarray(episodes.actions), reset_key)
    stages = {
        "bare": Stage(bare, 2 * num_directions * episode_length, bare_compile_s),
        "rollout": Stage(rollout, int(episodes.env_steps), rollout_compile_s),
        "train": Stage(lambda: update(state), int(update(state)[1]["env_steps"]), update_compile_s),
    }
    speeds: dict[str, list[float]] = {name: [] for name in stages}
    for _ in range(repeats):
        for name, stage in stages.items():
            started = time.perf_counter()
            jax.block_until_ready(stage.call())
            speeds[name].append(stage.live_steps / (time.perf_counter() - started))
    utilization = float(episodes.env_steps / episodes.slot_steps)
    memory = _peak_memory_mb()
    rows = tuple(
        Row(
            env=env_id,
            physics=engine,
            stage=name,
            env_steps_per_s=float(np.median(speeds[name])),
            compile_s=stage.compile_s,
            peak_memory_mb=memory,
            utilization=utilization if name == "rollout" and engine == "mjx" else None,
        )
        for name, stage in stages.items()
    )
    ratios = {
        f"{env_id} {engine} {name} / bare": float(
            np.median(np.divide(speeds[name], speeds["bare"]))
        )
        for name in ("rollout", "train")
    }
    return Measurement(rows, ratios)


def measure_peer(name: str, env_id: str, num_directions: int, episode_length: int) -> Row:
    """Measure the speed of a peer."""
    set_up_jax()
    peer = peers.PEERS[name]
    with _silenced():
        speed = peer.measure(env_id, num_directions, episode_length)
    return Row(env_id, peer.physics, f"peer:{name}", speed, None, _peak_memory_mb())


@contextlib.contextmanager
def _silenced() -> Iterator[None]:
    """Hide the warnings of peers and their processes, and keep their files out of here."""
    with (
        tempfile.TemporaryDirectory() as directory,
        contextlib.chdir(directory),
        Path(os.devnull).open("w") as nowhere,
    ):
        stderr = os.dup(2)
        os.dup2(nowhere.fileno(), 2)
        try:
            yield
        finally:
            os.dup2(stderr, 2)
            os.close(stderr)


def _demonstrations(env: MujocoTask) -> Demonstrations:
    """Return ten episodes of noise, because the speed does not depend on their content."""
    rng = np.random.default_rng(0)
    return Demonstrations(
        observations=rng.normal(size=(10, 1000, env.observation_size)).astype(np.float32),
        actions=rng.uniform(-1, 1, (10, 1000, env.action_size)).astype(np.float32),
        lengths=np.full(10, 1000),
        returns=np.zeros(10, np.float32),
        env_id="noise",
    )


def _shared_evenly(simulator: Simulator, num_episodes: int) -> Simulator:
    """Leave out devices until the others can share the episodes evenly."""
    mesh = simulator.mesh
    while mesh is not None and num_episodes % mesh.size:
        mesh = jax.sharding.Mesh(mesh.devices[:-1], mesh.axis_names)
    return dataclasses.replace(simulator, mesh=mesh)


def _rollout(
    trainer: Ailsrs, state: TrainState, noise_key: jax.Array, reset_key: jax.Array
) -> Callable[[], Episodes]:
    """Return a program that simulates the episodes of the perturbed policies."""
    settings = dataclasses.replace(trainer.settings, num_evaluation_episodes=0)

    def rollout() -> Episodes:
        deltas = random_search.sample_directions(
            noise_key, settings.num_directions, state.weights.shape
        )
        policy = trainer.policy(state.weights, state.statistics)
        return explore(trainer.simulator, policy, deltas, reset_key, settings).episodes

    return rollout


def _bare(
    simulator: Simulator, actions: np.ndarray, reset_key: jax.Array
) -> tuple[Callable[[], Any], float]:
    """Return a program that replays ``actions (B, T, p)``, and how long it took to compile."""
    env = simulator.env
    _, exploration_key = jax.random.split(reset_key)
    keys = jax.random.split(exploration_key, (2, len(actions) // 2)).ravel()
    initial = jax.jit(jax.vmap(env.reset))(keys).pipeline_state
    if env.physics.name == "mujoco":
        return _bare_mujoco(env, initial, actions), 0.0

    def share(state: PhysicsState, actions: jax.Array) -> jax.Array:
        step, live = jax.vmap(env.physics.step, (0, 0, None)), jax.numpy.array(True)
        state, _ = jax.lax.scan(
            lambda s, a: (step(s, a, live), None), state, actions.swapaxes(0, 1)
        )
        return state.qpos

    if simulator.mesh is not None:
        spec = jax.sharding.PartitionSpec(AXIS)
        share = jax.shard_map(
            share, mesh=simulator.mesh, in_specs=spec, out_specs=spec, check_vma=False
        )
    replay, compile_s = _compile(share, initial, actions)
    return lambda: replay(initial, actions), compile_s


def _bare_mujoco(env: MujocoTask, initial: PhysicsState, actions: np.ndarray) -> Callable[[], None]:
    model, frame_skip, cores = env.physics.model, env.physics.frame_skip, available_cores()
    first = np.zeros((len(actions), 1 + model.nq + model.nv))  # time, positions, velocities
    first[:, 1:] = np.concatenate([initial.qpos, initial.qvel], axis=1)
    controls = np.repeat(actions, frame_skip, axis=1).astype(float)
    data = [mujoco.MjData(model) for _ in range(cores)]
    pool = mujoco.rollout.Rollout(nthread=cores)

    def replay() -> None:
        # One environment step in a call, as with a policy, which needs the state to choose the next
        # action. Fifty in a call, which keep a simulation in the cache, were 11 % faster on
        # HalfCheetah and 5 % on Hopper.
        state = first
        for start in range(0, controls.shape[1], frame_skip):
            steps, _ = pool.rollout(model, data, state, controls[:, start : start + frame_skip])
            state = steps[:, -1]

    return replay


def _compile(function: Callable[..., Any], *arguments: Any) -> tuple[Callable[..., Any], float]:
    started = time.perf_counter()
    compiled = jax.jit(function).lower(*arguments).compile()
    return compiled, time.perf_counter() - started


def _peak_memory_mb() -> float:
    stats = jax.local_devices()[0].memory_stats()
    if stats:
        return float(stats["peak_bytes_in_use"]) / 2**20
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss  # in KiB, but in bytes on macOS
    return float(peak) / (2**20 if sys.platform == "darwin" else 2**10)


def _in_a_process(function: Callable[..., Any], *arguments: Any) -> Any:
    """Call ``function`` in a new process, with its own memory and JAX."""
    context = multiprocessing.get_context("spawn")
    with concurrent.futures.ProcessPoolExecutor(1, mp_context=context) as pool:
        try:
            return pool.submit(function, *arguments).result()
        except UserError:
            raise
        except Exception as error:
            what = f"{function.__name__}{arguments}"
            raise UserError(f"{what} failed: {type(error).__name__} {error}") from error
