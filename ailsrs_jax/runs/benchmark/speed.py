"""Measure the speed of bare physics, episodes, training steps and installed peers."""

import concurrent.futures
import contextlib
import dataclasses
import importlib.util
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
import numpy as np

from ailsrs_jax.data.demonstrations import Demonstrations
from ailsrs_jax.envs.physics import InitialState
from ailsrs_jax.envs.registry import TASKS, make_env
from ailsrs_jax.envs.tasks.mujoco_task import MujocoTask
from ailsrs_jax.errors import UserError, refusing
from ailsrs_jax.runs.benchmark import peers
from ailsrs_jax.runs.benchmark.replay import bare, limit
from ailsrs_jax.runs.demonstrate import expert_demonstrations
from ailsrs_jax.runs.devices import choose_simulator, compiler_options, set_up_jax
from ailsrs_jax.runs.iterations import compiled
from ailsrs_jax.trainers.ailsrs import make_ailsrs
from ailsrs_jax.trainers.algorithms import preset_settings
from ailsrs_jax.trainers.parts.rollout import Simulator


@dataclasses.dataclass(frozen=True)
class Row:
    """The speed of one stage."""

    env: str
    physics: str  # the engine, ours or the peer's
    stage: str  # limit, bare, simulate, train or peer:NAME
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
    num_directions: int | None,
    episode_length: int,
    repeats: int,
) -> Iterator[Measurement]:
    """Measure every task on every engine and with every peer, each in its own process.

    Without ``num_directions`` each task gets as many as in the preset ``tuned``.

    Raises:
        UserError: a measurement failed that is not a peer's.
    """
    for env_id in env_ids:
        speeds: dict[str, float] = {}
        size = num_directions or preset_settings(env_id, "tuned").num_directions
        for engine in engines:
            arguments = (env_id, engine, size, episode_length, repeats)
            measurement = _in_a_process(measure, *arguments)
            speeds[engine] = measurement.rows[-1].env_steps_per_s
            yield measurement
        for name, peer in peers.PEERS.items():
            if env_id not in TASKS or importlib.util.find_spec(peer.package) is None:
                continue
            try:
                row = _in_a_process(measure_peer, name, env_id, size, episode_length)
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
    """Measure the stages of a task on an engine, in turns; ratios compare speeds of the same turn.

    ``train`` is the second iteration of the preset ``tuned`` with ten demonstrations of the shipped
    expert, ``simulate`` its episodes. ``limit`` and ``bare`` replay the actions of these episodes
    from the same initial states, without policies, observations or rewards. ``limit`` runs
    whole episodes on all cores, the longest first; only the C engine can do so. ``bare`` makes one
    step of all episodes at a time, up to the time limit.
    """
    set_up_jax()
    env = make_env(env_id, engine)
    preset = preset_settings(env_id, "tuned")
    settings = dataclasses.replace(
        preset,
        num_directions=num_directions,
        num_top_directions=min(preset.num_top_directions, num_directions),
        episode_length=episode_length,
    )
    simulator = _shared_evenly(choose_simulator(env), settings.num_perturbed)
    trainer = make_ailsrs(simulator, _demonstrations(env, env_id, engine), settings)
    place, options = simulator.everywhere, compiler_options(env)
    state = jax.jit(trainer.init, out_shardings=place)(jax.random.key(0))
    update, update_compile_s = compiled(trainer.update, state, place=place, options=options)
    state, _ = update(state)
    key = jax.random.key(1)
    starts = trainer.starts(key)
    if not isinstance(starts, InitialState):
        starts = jax.jit(jax.vmap(env.draw_start))(starts)
    simulate, simulate_compile_s = compiled(
        lambda: trainer.simulate(state, trainer.ask(jax.random.key(2)), key), options=options
    )
    episodes = simulate()
    actions, lengths = np.asarray(episodes.actions), np.asarray(episodes.lengths)
    replay, bare_compile_s = bare(simulator, starts, actions)
    stages = {
        "bare": Stage(replay, actions[..., 0].size, bare_compile_s),
        "simulate": Stage(simulate, int(lengths.sum()), simulate_compile_s),
        "train": Stage(lambda: update(state), int(update(state)[1]["env_steps"]), update_compile_s),
    }
    if engine == "mujoco":
        whole = Stage(limit(env, starts, actions, lengths), int(lengths.sum()), 0.0)
        stages = {"limit": whole, **stages}
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
            utilization=utilization if name == "simulate" and engine == "mjx" else None,
        )
        for name, stage in stages.items()
    )
    ratios = {
        f"{env_id} {engine} {name} / {whole}": float(
            np.median(np.divide(speeds[name], speeds[whole]))
        )
        for whole in ("limit", "bare")
        for name in ("simulate", "train")
        if whole in speeds
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


def _demonstrations(env: MujocoTask, env_id: str, engine: str) -> Demonstrations:
    """Return ten episodes of the shipped expert; of noise for a task of the user's own."""
    if env_id in TASKS:
        return expert_demonstrations(env_id, 10, engine)
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


def _peak_memory_mb() -> float:
    stats = jax.local_devices()[0].memory_stats()
    if stats:
        return float(stats["peak_bytes_in_use"]) / 2**20
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss  # in KiB, but in bytes on macOS
    return float(peak) / (2**20 if sys.platform == "darwin" else 2**10)


def _in_a_process(function: Callable[..., Any], *arguments: Any) -> Any:
    """Call ``function`` in a new process, with its own memory and JAX."""
    context = multiprocessing.get_context("spawn")
    with (
        refusing(f"{function.__name__}{arguments} failed"),
        concurrent.futures.ProcessPoolExecutor(1, mp_context=context) as pool,
    ):
        return pool.submit(function, *arguments).result()
