"""The base class of MuJoCo locomotion tasks, as a Brax environment."""

import importlib.util
import os
from abc import abstractmethod
from pathlib import Path

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from ailsrs_jax.envs import Env, State
from ailsrs_jax.envs.physics import Physics, PhysicsState, make_physics
from ailsrs_jax.envs.physics.quiet import without_warnings
from ailsrs_jax.errors import UserError


class MujocoTask(Env):
    """A locomotion task with Gymnasium v5's model, observation, reward, reset and termination.

    The model file is read from the installed ``gymnasium``, so it cannot differ from theirs. A task
    neither restarts episodes nor limits their time: ``done`` becomes 1 when the episode ends in a
    terminal state, and later states are meaningless.

    It is also the base class of your own tasks, with any model whose actuators have a
    ``ctrlrange``. A subclass defines the terms of the reward and, where they differ, the
    termination, reset noise and observation. As in Gymnasium, actions are not clipped here: MuJoCo
    clamps the controls, and the control cost is computed from the action as given.
    """

    def __init__(
        self,
        *,
        physics: str,
        xml_file: str,
        frame_skip: int,
        reset_noise_scale: float,
        num_hidden_positions: int,
        readings: tuple[str, ...] = (),
    ) -> None:
        """Load the model.

        Args:
            physics: ``auto``, ``mjx`` or ``mujoco``.
            xml_file: the file name of one of Gymnasium's models, or the path of your own, which
                begins with ``/``, ``.`` or ``~``.
            frame_skip: physics steps per environment step.
            reset_noise_scale: size of the noise on the initial positions and velocities.
            num_hidden_positions: number of leading entries of ``qpos`` that are not observed.
            readings: fields of ``mjData`` that the task needs besides ``qpos`` and ``qvel``.
        """
        model = load_model(xml_file)
        self.physics: Physics = make_physics(physics, model, frame_skip, readings)
        self.dt = float(model.opt.timestep) * frame_skip
        self._reset_noise_scale = reset_noise_scale
        self._num_hidden_positions = num_hidden_positions
        self._initial_qpos = jnp.asarray(model.qpos0, jnp.float32)
        self.action_low = np.float32(model.actuator_ctrlrange[:, 0])
        self.action_high = np.float32(model.actuator_ctrlrange[:, 1])

    @property
    def observation_size(self) -> int:
        """Length n of an observation."""
        model = self.physics.model
        return int(model.nq + model.nv - self._num_hidden_positions)

    @property
    def action_size(self) -> int:
        """Length p of an action."""
        return int(self.physics.model.nu)

    @property
    def ends_early(self) -> bool:
        """Whether an episode can end before its time limit."""
        return type(self)._terminated is not MujocoTask._terminated

    @property
    def backend(self) -> str:
        """The physics engine's name."""
        return self.physics.name

    def reset(self, rng: jax.Array) -> State:
        """Start an episode from the initial pose plus noise drawn with the key ``rng``."""
        qpos_key, qvel_key = jax.random.split(rng)
        noise = self._reset_noise_scale
        qpos = self._initial_qpos + jax.random.uniform(
            qpos_key, self._initial_qpos.shape, minval=-noise, maxval=noise
        )
        physics_state = self.physics.init(qpos, self._initial_velocity(qvel_key))
        action = jnp.zeros(self.action_size)
        zeros = jax.tree.map(
            jnp.zeros_like, self._reward_terms(physics_state, physics_state, action)
        )
        return State(
            pipeline_state=physics_state,
            obs=self._observation(physics_state),
            reward=jnp.zeros(()),
            done=jnp.zeros(()),
            metrics=zeros | self._positions(physics_state),
        )

    def step(self, state: State, action: jax.Array) -> State:
        """Apply ``action (p,)`` for ``frame_skip`` physics steps."""
        before = state.pipeline_state
        after = self.physics.step(before, action, state.done == 0)
        terms = self._reward_terms(before, after, action)
        return state.replace(
            pipeline_state=after,
            obs=self._observation(after),
            reward=sum(terms.values()),
            done=self._terminated(after).astype(jnp.float32),
            # Brax's wrappers add metrics of their own, which are kept.
            metrics=state.metrics | terms | self._positions(after),
        )

    @abstractmethod
    def _reward_terms(
        self, before: PhysicsState, after: PhysicsState, action: jax.Array
    ) -> dict[str, jax.Array]:
        """The terms whose sum is the environment's reward, under Gymnasium's names."""

    def _terminated(self, physics_state: PhysicsState) -> jax.Array:
        del physics_state
        return jnp.zeros((), bool)

    def _observation(self, physics_state: PhysicsState) -> jax.Array:
        positions = physics_state.qpos[self._num_hidden_positions :]
        return jnp.concatenate([positions, physics_state.qvel])

    def _positions(self, physics_state: PhysicsState) -> dict[str, jax.Array]:
        return {"x_position": physics_state.qpos[0]}

    def _initial_velocity(self, key: jax.Array) -> jax.Array:
        noise = self._reset_noise_scale
        return jax.random.uniform(key, (self.physics.model.nv,), minval=-noise, maxval=noise)

    def _normal_velocity(self, key: jax.Array) -> jax.Array:
        return self._reset_noise_scale * jax.random.normal(key, (self.physics.model.nv,))

    def _forward_velocity(self, before: PhysicsState, after: PhysicsState) -> jax.Array:
        return (self._forward_position(after) - self._forward_position(before)) / self.dt

    def _forward_position(self, physics_state: PhysicsState) -> jax.Array:
        return physics_state.qpos[0]


def load_model(xml_file: str) -> mujoco.MjModel:
    """Read one of Gymnasium's models by its file name, or your own by its path.

    Raises:
        UserError: the file does not exist, or MuJoCo cannot read it.
    """
    gymnasium = importlib.util.find_spec("gymnasium")
    assert gymnasium is not None
    assert gymnasium.submodule_search_locations is not None
    assets = Path(gymnasium.submodule_search_locations[0], "envs", "mujoco", "assets")
    is_path = xml_file.startswith((".", "~", os.sep))
    path = Path(xml_file).expanduser() if is_path else assets / xml_file
    if not path.is_file():
        raise UserError(f"no model file {path}")
    try:
        with without_warnings():  # for example, that a model is outdated
            return mujoco.MjModel.from_xml_path(str(path))
    except ValueError as error:
        raise UserError(f"MuJoCo cannot read {path}: {str(error).splitlines()[0]}") from error
