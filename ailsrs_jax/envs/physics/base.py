"""What a task needs from a physics engine."""

from typing import Protocol

import jax
import mujoco
from flax import struct


class PhysicsState(struct.PyTreeNode):
    """The state of one simulation: what tasks read, and what its engine alone needs to continue."""

    qpos: jax.Array  # (nq,) float32, generalised positions [m, rad]
    qvel: jax.Array  # (nv,) float32, generalised velocities [m/s, rad/s]
    carry: jax.Array  # private to the engine that made it


class Physics(Protocol):
    """Advances one MuJoCo model; pure, and batched by ``jax.vmap``.

    Attributes:
        name: the engine's name on the command line.
        model: the MuJoCo model that is simulated.
        frame_skip: physics steps in one call of :meth:`step`.
    """

    name: str
    model: mujoco.MjModel
    frame_skip: int

    def init(self, qpos: jax.Array, qvel: jax.Array) -> PhysicsState:
        """Start a simulation at rest time from positions ``(nq,)`` and velocities ``(nv,)``."""
        ...

    def step(self, state: PhysicsState, ctrl: jax.Array, live: jax.Array) -> PhysicsState:
        """Advance ``frame_skip`` physics steps under the constant controls ``ctrl (nu,)``.

        ``live`` is a boolean scalar: an engine may leave a simulation that is not live as it is.
        """
        ...
