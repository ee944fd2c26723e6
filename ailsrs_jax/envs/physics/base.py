"""The interface between tasks and physics engines."""

from typing import Any, NamedTuple, Protocol

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from flax import struct

# Beyond this MuJoCo regards a simulation as unstable. Sums of its square still fit into float32.
LARGEST = float(mujoco.mjMAXVAL)  # 1e10

STATE = ("qpos", "qvel")  # the fields of ``mjData`` that every state has


class Range(NamedTuple):
    """Consecutive numbers of a field of ``mjData``, and limits that hold for each of them."""

    field: str
    first: int = 0
    end: int | None = None  # the first number after them
    low: float = -np.inf
    high: float = np.inf


class InitialState(struct.PyTreeNode):
    """Where an episode begins."""

    qpos: jax.Array  # (nq,) float32, generalised positions [m, rad]
    qvel: jax.Array  # (nv,) float32, generalised velocities [m/s, rad/s]


class Perceptrons(struct.PyTreeNode):
    """B multilayer perceptrons of standardised observations; a linear policy has one layer."""

    parameters: jax.Array  # (B, k) float32; each layer's weights (in, out), then its biases (out,)
    mean: jax.Array  # (B, n)
    std: jax.Array  # (B, n)
    action_low: jax.Array  # (B, p)
    action_high: jax.Array  # (B, p)
    #: the numbers of inputs, of each hidden layer of tanh units, and of outputs
    sizes: tuple[int, ...] = struct.field(pytree_node=False)


class Trajectories(NamedTuple):
    """B episodes of at most T steps; numbers after an episode's end are zeros."""

    observations: Any  # (B, T, n) float32, what the policy saw
    actions: Any  # (B, T, p) float32, clipped
    records: Any  # (B, T + 1, r) float32, numbers that rewards need, at the start and later
    final_observations: Any  # (B, n) float32, after the last step
    lengths: Any  # (B,) int32
    diverged: Any  # (B,) bool, the next step was not finite


class Segments(NamedTuple):
    """L consecutive steps in each of S simulations, where one episode follows another."""

    observations: Any  # (S, L, n) float32, what the policy saw
    actions: Any  # (S, L, p) float32, clipped
    next_observations: Any  # (S, L, n) float32, of the same episode
    terminated: Any  # (S, L) bool, the episode ended in a terminal state
    over: Any  # (S, L) bool, it ended there, for whatever reason
    diverged: Any  # (S, L) bool, the step was not finite; its other numbers mean nothing


def trajectory_types(
    num_episodes: int, episode_length: int, n: int, p: int, num_records: int = 0
) -> Trajectories:
    """Return the shapes and types of episodes with n observed numbers and p actions."""
    shapes = (episode_length, n), (episode_length, p), (episode_length + 1, num_records), (n,)
    arrays = [jax.ShapeDtypeStruct((num_episodes, *shape), np.float32) for shape in shapes]
    ends = [jax.ShapeDtypeStruct((num_episodes,), kind) for kind in (np.int32, bool)]
    return Trajectories(*arrays, *ends)


def segment_types(shape: tuple[int, ...], n: int, p: int) -> Segments:
    """Return the shapes and types of segments of ``shape (S, L)``."""
    observations = jax.ShapeDtypeStruct((*shape, n), np.float32)
    actions = jax.ShapeDtypeStruct((*shape, p), np.float32)
    flags = jax.ShapeDtypeStruct(shape, bool)
    return Segments(observations, actions, observations, flags, flags, flags)


class PhysicsState(struct.PyTreeNode):
    """The state of one simulation: the fields that tasks read, and the engine's private state."""

    qpos: jax.Array  # (nq,) float32, generalised positions [m, rad]
    qvel: jax.Array  # (nv,) float32, generalised velocities [m/s, rad/s]
    carry: jax.Array  # private to the engine that made it
    # The fields of mjData that the task asked for, by name, as float32. After a step MuJoCo leaves
    # in them the values of its last integration stage, not those of the final state.
    readings: dict[str, jax.Array] = struct.field(default_factory=dict)


class Physics(Protocol):
    """Simulates one MuJoCo model; its methods are pure and batched by ``jax.vmap``."""

    name: str  # on the command line
    model: mujoco.MjModel
    frame_skip: int  # physics steps in one call of step
    readings: tuple[str, ...]  # fields of MuJoCo's mjData that every state carries

    def init(self, qpos: jax.Array, qvel: jax.Array) -> PhysicsState:
        """Start a simulation at time zero from positions ``(nq,)`` and velocities ``(nv,)``.

        ``cfrc_ext`` is zero even where bodies touch, because no force has acted yet.
        """
        ...

    def step(self, state: PhysicsState, ctrl: jax.Array, live: jax.Array) -> PhysicsState:
        """Advance ``frame_skip`` physics steps under the constant controls ``ctrl (nu,)``.

        ``live`` is a boolean scalar; an engine may skip a simulation that is not live. A simulation
        that MuJoCo finds unstable is not reset; its state becomes NaN sooner or later.
        """
        ...


def read(physics_state: PhysicsState, part: Range) -> jax.Array:
    """Return the numbers of ``part``, ``(k,)``."""
    in_state = part.field in STATE
    field = getattr(physics_state, part.field) if in_state else physics_state.readings[part.field]
    return field.ravel()[part.first : part.end]


def all_within(physics_state: PhysicsState, limits: tuple[Range, ...]) -> jax.Array:
    """Whether all numbers are strictly within their limits, ``()`` bool."""
    parts = [(read(physics_state, part), part) for part in limits]
    within = [jnp.all((part.low < numbers) & (numbers < part.high)) for numbers, part in parts]
    return jnp.all(jnp.array(within))
