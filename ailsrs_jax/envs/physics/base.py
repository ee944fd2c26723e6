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
    # What else the task asked for: MuJoCo's name of the field → its value, as float32. After a step
    # these are what MuJoCo leaves, of its last integration stage rather than of the final state.
    readings: dict[str, jax.Array] = struct.field(default_factory=dict)


class Physics(Protocol):
    """Advances one MuJoCo model; pure, and batched by ``jax.vmap``.

    Attributes:
        name: the engine's name on the command line.
        model: the MuJoCo model that is simulated.
        frame_skip: physics steps in one call of :meth:`step`.
        readings: fields of MuJoCo's ``mjData`` that every state carries.
    """

    name: str
    model: mujoco.MjModel
    frame_skip: int
    readings: tuple[str, ...]

    def init(self, qpos: jax.Array, qvel: jax.Array) -> PhysicsState:
        """Start a simulation at rest time from positions ``(nq,)`` and velocities ``(nv,)``.

        No force has acted yet: ``cfrc_ext`` is zero, even where bodies touch.
        """
        ...

    def step(self, state: PhysicsState, ctrl: jax.Array, live: jax.Array) -> PhysicsState:
        """Advance ``frame_skip`` physics steps under the constant controls ``ctrl (nu,)``.

        ``live`` is a boolean scalar: an engine may leave a simulation that is not live as it is.
        A simulation that MuJoCo finds unstable is not reset: sooner or later its state is NaN.
        """
        ...
