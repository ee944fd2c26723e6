"""How fast tasks are stepped here: bare physics, rollouts, training steps and installed peers."""

import concurrent.futures
import contextlib
import dataclasses
import multiprocessing
import os
import resource
import statistics
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

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
    """One measurement."""

    env: str
    physics: str  # a peer's own, for a peer
    stage: str  # bare, rollout, train or peer:NAME
    env_steps_per_s: float  # of live episodes; the median of the repeats
    compile_s: float | None
    peak_memory_mb: float  # of the process that measured it, or of its accelerator
    utilization: float | None = None  # live steps / steps of the slots that simulated them


@dataclasses.dataclass(frozen=True)
class Measurement:
    """What one process measured."""

    rows: tuple[Row, ...]
    ratios: dict[str, float]  # of speeds
    problem: str = ""  # why there are none


def benchmark(
    env_ids: Sequence[str],
    engines: Sequence[str],
    num_directions: int,
    episode_length: int,
    repeats: int,
) -> Iterator[Measurement]:
    """Measure every task on every engine and with every peer, each in a process of its own.

    Raises:
        UserError: a measurement of ours failed.
    """
    for env_id in env_ids:
        speeds: dict[str, float] = {}
        for engine in engines:
            arguments = (env_id, engine, num_directions, episode_length, repeats)
            measurement = _in_a_process(measure, *arguments)
            speeds[engine] = measurement.rows[-1].env_steps_per_s
            yield measurement
        for name, peer in peers.PEERS.items():
            if env_id in TASKS and peer.is_installed():
                try:
                    row = _in_a_process(measure_peer, name, env_id, num_directions, episode_length)
                except UserError as error:  # theirs: ours are still worth having
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
    """Bare physics, the rollout and the training step of one task on one engine, taking turns.

    All simulate the first iteration of the paper's preset, from zero weights; speeds are compared
    turn by turn. Bare physics replays the actions of the rollout from the same initial states, one
    environment step after the other, with no policy, observation, reward or end of an episode.
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
    simulator = choose_simulator(env)
    trainer = make_ailsrs(simulator, _demonstrations(env), settings)
    state = jax.jit(trainer.init)(jax.random.key(0))
    noise_key, reset_key = jax.random.split(jax.random.key(1))
    rollout, rollout_compile_s = _compile(_rollout(trainer, state, noise_key, reset_key))
    update, update_compile_s = _compile(trainer.update, state)
    episodes = rollout()
    bare, bare_compile_s = _bare(simulator, np.asarray(episodes.actions), reset_key)

    compile_s = {"bare": bare_compile_s, "rollout": rollout_compile_s, "train": update_compile_s}
    live_steps = {
        "bare": 2 * num_directions * episode_length,
        "rollout": int(episodes.env_steps),
        "train": int(update(state)[1]["env_steps"]),
    }
    calls: dict[str, Callable[[], Any]] = {
        "bare": bare,
        "rollout": rollout,
        "train": lambda: update(state),
    }
    speeds: dict[str, list[float]] = {stage: [] for stage in calls}
    for _ in range(repeats):
        for stage, call in calls.items():
            started = time.perf_counter()
            jax.block_until_ready(call())
            speeds[stage].append(live_steps[stage] / (time.perf_counter() - started))

    memory = _peak_memory_mb()
    utilization = float(episodes.env_steps / episodes.slot_steps)
    rows = tuple(
        Row(
            env=env_id,
            physics=engine,
            stage=stage,
            env_steps_per_s=statistics.median(speeds[stage]),
            compile_s=compile_s[stage],
            peak_memory_mb=memory,
            utilization=utilization if stage == "rollout" and engine == "mjx" else None,
        )
        for stage in calls
    )
    ratios = {
        f"{env_id} {engine} {stage} / bare": statistics.median(
            np.divide(speeds[stage], speeds["bare"]).tolist()
        )
        for stage in ("rollout", "train")
    }
    return Measurement(rows, ratios)


def measure_peer(name: str, env_id: str, num_directions: int, episode_length: int) -> Row:
    """The speed of one peer."""
    set_up_jax()
    peer = peers.PEERS[name]
    with _unheard():
        speed = peer.measure(env_id, num_directions, episode_length)
    return Row(
        env=env_id,
        physics=peer.physics,
        stage=f"peer:{name}",
        env_steps_per_s=speed,
        compile_s=None,
        peak_memory_mb=_peak_memory_mb(),
    )


@contextlib.contextmanager
def _unheard() -> Iterator[None]:
    """Keep what peers and their own processes warn about off the terminal and out of files here."""
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
    """Ten episodes of noise: what they hold makes no difference to the speed."""
    rng = np.random.default_rng(0)
    return Demonstrations(
        observations=rng.normal(size=(10, 1000, env.observation_size)).astype(np.float32),
        actions=rng.uniform(-1, 1, (10, 1000, env.action_size)).astype(np.float32),
        lengths=np.full(10, 1000),
        returns=np.zeros(10, np.float32),
        env_id="noise",
    )


def _rollout(
    trainer: Ailsrs, state: TrainState, noise_key: jax.Array, reset_key: jax.Array
) -> Callable[[], Episodes]:
    """The perturbed policies' episodes."""
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
    """Physics alone, under the given ``actions (B, T, p)``, and how long it took to compile."""
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
        # One environment step in a call: who chooses actions can have no more. Fifty in a call,
        # which leave a simulation in its cache, were 11 % faster on HalfCheetah, 5 % on Hopper.
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
    statistics = jax.local_devices()[0].memory_stats()
    if statistics:
        return float(statistics["peak_bytes_in_use"]) / 2**20
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss  # in KiB, on macOS in bytes
    return float(peak) / (2**20 if sys.platform == "darwin" else 2**10)


def _in_a_process(function: Callable[..., Any], *arguments: Any) -> Any:
    """Call in a new process, whose memory and JAX are its own."""
    context = multiprocessing.get_context("spawn")
    with concurrent.futures.ProcessPoolExecutor(1, mp_context=context) as pool:
        try:
            return pool.submit(function, *arguments).result()
        except UserError:
            raise
        except Exception as error:
            what = f"{function.__name__}{arguments}"
            raise UserError(f"{what} failed: {type(error).__name__} {error}") from error
