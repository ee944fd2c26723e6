"""Bare physics: replay the actions of episodes, without policies, observations or rewards."""

import concurrent.futures
from collections.abc import Callable
from typing import Any

import jax
import mujoco.rollout
import numpy as np

from ailsrs_jax.envs.physics import InitialState, PhysicsState
from ailsrs_jax.envs.tasks.mujoco_task import MujocoTask
from ailsrs_jax.runs.iterations import compiled
from ailsrs_jax.trainers.parts.rollout import Simulator
from ailsrs_jax.trainers.parts.sharing import shared
from ailsrs_jax.versions import available_cores


def bare(
    simulator: Simulator, starts: InitialState, actions: np.ndarray
) -> tuple[Callable[[], Any], float]:
    """Return a program that replays ``actions (B, T, p)``, and how long it took to compile."""
    env = simulator.env
    if env.physics.name == "mujoco":
        return _bare_mujoco(env, starts, actions), 0.0
    initial = jax.jit(jax.vmap(env.start))(starts).pipeline_state

    def share(state: PhysicsState, actions: jax.Array) -> jax.Array:
        step, live = jax.vmap(env.physics.step, (0, 0, None)), jax.numpy.array(True)
        state, _ = jax.lax.scan(
            lambda s, a: (step(s, a, live), None), state, actions.swapaxes(0, 1)
        )
        return state.qpos

    if simulator.mesh is not None:
        share = shared(share, simulator.mesh)
    replay, compile_s = compiled(share, initial, actions)
    return lambda: replay(initial, actions), compile_s


def _bare_mujoco(env: MujocoTask, starts: InitialState, actions: np.ndarray) -> Callable[[], None]:
    model, frame_skip, cores = env.physics.model, env.physics.frame_skip, available_cores()
    first, controls = _full_states(starts), _controls(env, actions)
    data = [mujoco.MjData(model) for _ in range(cores)]
    pool = mujoco.rollout.Rollout(nthread=cores)

    def replay() -> None:
        state = first
        for start in range(0, controls.shape[1], frame_skip):
            steps, _ = pool.rollout(model, data, state, controls[:, start : start + frame_skip])
            state = steps[:, -1]

    return replay


def limit(
    env: MujocoTask, starts: InitialState, actions: np.ndarray, lengths: np.ndarray
) -> Callable[[], None]:
    """Replay whole episodes with MuJoCo's own function, one on each core, the longest first."""
    model, cores = env.physics.model, available_cores()
    first, controls = _full_states(starts), _controls(env, actions)
    num_steps = lengths * env.physics.frame_skip
    threads = concurrent.futures.ThreadPoolExecutor(cores)

    def replay() -> None:
        waiting = iter(np.argsort(-lengths).tolist())

        def replay_some(_: int) -> None:
            data = mujoco.MjData(model)
            with mujoco.rollout.Rollout(nthread=0) as pool:
                for i in waiting:
                    pool.rollout(model, data, first[i], controls[i, : num_steps[i]])

        list(threads.map(replay_some, range(cores)))

    return replay


def _full_states(starts: InitialState) -> np.ndarray:
    """``(B, 1 + nq + nv)``: time, positions, velocities."""
    return np.concatenate([np.zeros((len(starts.qpos), 1)), starts.qpos, starts.qvel], axis=1)


def _controls(env: MujocoTask, actions: np.ndarray) -> np.ndarray:
    """The controls of every physics step."""
    return np.repeat(actions, env.physics.frame_skip, axis=1).astype(float)
