"""The base class of MuJoCo locomotion tasks, as a Brax environment."""

import functools
from abc import abstractmethod
from typing import TYPE_CHECKING

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from ailsrs_jax.envs import Env, State
from ailsrs_jax.envs.physics import (
    InitialState,
    Perceptrons,
    Physics,
    PhysicsState,
    Range,
    Segments,
    Trajectories,
    make_physics,
)
from ailsrs_jax.envs.physics.base import STATE, all_within, read
from ailsrs_jax.envs.tasks.model_file import load_model
from ailsrs_jax.errors import UserError
from ailsrs_jax.versions import available_cores

if TYPE_CHECKING:
    from ailsrs_jax.envs.physics.episode_runner import EpisodeRunner


class MujocoTask(Env):
    """A locomotion task with Gymnasium v5's model, observation, reward, reset and termination.

    The model file is read from the installed ``gymnasium``, so it cannot differ from theirs. A task
    neither restarts episodes nor limits their time: ``done`` becomes 1 when the episode ends in a
    terminal state, and later states are meaningless.

    It is also the base class of your own tasks, with any model whose actuators have a
    ``ctrlrange``. A subclass defines the terms of the reward and, where they differ, the reset
    noise, the observed numbers (``_observed``) and the limits beyond which an episode ends
    (``_limits``). As in Gymnasium, actions are not clipped here: MuJoCo clamps the controls, and
    the control cost is computed from the action as given.
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
            physics: ``auto``, ``mjx``, ``mujoco`` or ``warp``.
            xml_file: the file name of one of Gymnasium's models, or the path of your own, which
                begins with ``/``, ``.`` or ``~``.
            frame_skip: physics steps per environment step.
            reset_noise_scale: size of the noise on the initial positions and velocities.
            num_hidden_positions: number of leading entries of ``qpos`` that are not observed.
            readings: fields of ``mjData`` that the reward needs besides ``qpos`` and ``qvel``.
        """
        if type(frame_skip) is not int or frame_skip < 1:
            raise UserError(f"frame_skip is {frame_skip!r}: it must be a whole number from 1")
        if not 0 <= reset_noise_scale < np.inf:
            raise UserError(f"reset_noise_scale is {reset_noise_scale}: it must not be negative")
        model = load_model(xml_file)
        self._num_hidden_positions = num_hidden_positions
        sensed = [part.field for part in (*self._observed(), *self._limits())]
        needed = dict.fromkeys(name for name in (*readings, *sensed) if name not in STATE)
        self.physics: Physics = make_physics(physics, model, frame_skip, tuple(needed))
        self.dt = float(model.opt.timestep) * frame_skip
        self._readings, self._reset_noise_scale = readings, reset_noise_scale
        self._initial_qpos = jnp.asarray(model.qpos0, jnp.float32)
        self.action_low = np.float32(model.actuator_ctrlrange[:, 0])
        self.action_high = np.float32(model.actuator_ctrlrange[:, 1])

    @functools.cached_property
    def observation_size(self) -> int:
        """Length n of an observation."""
        return sum(self._observed_sizes)

    @functools.cached_property
    def _observed_sizes(self) -> list[int]:
        """How many numbers each part of an observation has."""
        data, parts = mujoco.MjData(self.physics.model), self._observed()
        return [len(getattr(data, part.field).ravel()[part.first : part.end]) for part in parts]

    @property
    def action_size(self) -> int:
        """Length p of an action."""
        return int(self.physics.model.nu)

    @property
    def ends_early(self) -> bool:
        """Whether an episode can end before its time limit."""
        return self._has_own("_terminated") or len(self._limits()) > 0

    @property
    def backend(self) -> str:
        """The physics engine's name."""
        return self.physics.name

    def draw_start(self, key: jax.Array) -> InitialState:
        """Return the model's initial pose plus noise drawn with ``key``."""
        qpos_key, qvel_key = jax.random.split(key)
        noise = self._reset_noise_scale
        qpos = self._initial_qpos + jax.random.uniform(
            qpos_key, self._initial_qpos.shape, minval=-noise, maxval=noise
        )
        return InitialState(qpos, self._initial_velocity(qvel_key))

    def state_at(self, observation: jax.Array, _: jax.Array | None = None) -> InitialState:
        """Return the state of ``observation (n,)``; what it lacks is as in the initial pose."""
        state = {"qpos": self._initial_qpos, "qvel": jnp.zeros(self.physics.model.nv)}
        first = 0
        for part, size in zip(self._observed(), self._observed_sizes, strict=True):
            if part.field in state:
                numbers = observation[first : first + size]
                state[part.field] = state[part.field].at[part.first : part.end].set(numbers)
            first += size
        return InitialState(**state)

    def reset(self, rng: jax.Array) -> State:
        """Start an episode at :meth:`draw_start` of the key ``rng``."""
        return self.start(self.draw_start(rng))

    def start(self, initial: InitialState) -> State:
        """Start an episode at ``initial``."""
        physics_state = self.physics.init(initial.qpos, initial.qvel)
        action = jnp.zeros(self.action_size)
        zeros = jax.tree.map(jnp.zeros_like, self._rewards(physics_state, physics_state, action))
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
        terms = self._rewards(before, after, action)
        return state.replace(
            pipeline_state=after,
            obs=self._observation(after),
            reward=sum(terms.values()),
            done=self._terminated(after).astype(jnp.float32),
            # Brax's wrappers add metrics of their own, which are kept.
            metrics=state.metrics | terms | self._positions(after),
        )

    @property
    def runs_episodes(self) -> bool:
        """Whether :meth:`run_episodes` can be called: the C engine knows no subclass's methods."""
        known = not self._has_own("reset", "start", "step", "_observation", "_terminated")
        return self.physics.name == "mujoco" and known

    @property
    def runs_segments(self) -> bool:
        """Whether :meth:`run_segments` can be called: it does not keep states of actuators."""
        return self.runs_episodes and self.physics.model.na == 0

    @property
    def sets_observations(self) -> bool:
        """Whether :meth:`state_at` knows how observations are made."""
        return not self._has_own("reset", "start", "_observation")

    def _has_own(self, *methods: str) -> bool:
        """Whether a subclass defines one of these methods."""
        return any(getattr(type(self), name) is not getattr(MujocoTask, name) for name in methods)

    def run_episodes(
        self,
        policies: Perceptrons,
        starts: InitialState,
        noise: jax.Array,
        episode_length: int,
    ) -> tuple[Trajectories, jax.Array]:
        """Simulate an episode of each of B policies, on all cores.

        Args:
            policies: B policies.
            starts: of each episode.
            noise: ``(B, T, p)``, added to the actions before they are clipped; ``(B, 0, p)`` for
                none.
            episode_length: T, the time limit in environment steps.

        Returns:
            The episodes, and rewards ``(B, T)`` that mean nothing after an episode's end.
        """
        episodes = self._episode_runner.run_episodes(policies, starts, noise, episode_length)
        before = jax.tree.map(lambda x: x[:, :-1], episodes.records)
        after = jax.tree.map(lambda x: x[:, 1:], episodes.records)
        return episodes, self._recorded_rewards(before, after, episodes.actions)

    def begin_segments(self, starts: InitialState, episode_length: int) -> InitialState:
        """Return what :meth:`run_segments` goes on from, at the beginning of S episodes."""
        del episode_length
        return starts

    def run_segments(
        self,
        policies: Perceptrons,
        states: InitialState,
        times: jax.Array,
        restarts: InitialState,
        noise: jax.Array,
        episode_length: int,
    ) -> tuple[InitialState, jax.Array, Segments, jax.Array]:
        """Go on with S episodes for L steps each, on all cores; another one follows each.

        Args:
            policies: S policies.
            states: where the episodes are.
            times: ``(S,)`` int32, steps since each episode began.
            restarts: ``(S, L)`` starts, one for an episode that begins after each step.
            noise: ``(S, L, p)``, added to the actions before they are clipped.
            episode_length: T, the time limit in environment steps.

        Returns:
            States and times afterwards, the segments, and rewards ``(S, L)``.
        """
        states, times, segments, records = self._episode_runner.run_segments(
            policies, states, times, restarts, noise, episode_length
        )
        return states, times, segments, self._recorded_rewards(*records, segments.actions)

    def _recorded_rewards(
        self, before: dict[str, jax.Array], after: dict[str, jax.Array], actions: jax.Array
    ) -> jax.Array:
        """Rewards ``(B, T)`` of steps between recorded fields ``(B, T, ...)``."""

        def states(fields: dict[str, jax.Array]) -> PhysicsState:
            readings = {name: fields[name] for name in fields if name not in STATE}
            carry = jnp.zeros(actions.shape[:2])
            return PhysicsState(fields["qpos"], fields["qvel"], carry, readings)

        terms = jax.vmap(jax.vmap(self._reward_terms))(states(before), states(after), actions)
        return jnp.sum(jnp.stack(list(terms.values())), axis=0)

    @functools.cached_property
    def _episode_runner(self) -> "EpisodeRunner":
        from ailsrs_jax.envs.physics.episode_runner import EpisodeRunner  # slow to import

        return EpisodeRunner(
            self.physics.model,
            self.physics.frame_skip,
            available_cores(),
            observed=self._observed(),
            limits=self._limits(),
            recorded=(*STATE, *self._readings),
        )

    @abstractmethod
    def _reward_terms(
        self, before: PhysicsState, after: PhysicsState, action: jax.Array
    ) -> dict[str, jax.Array]:
        """The terms whose sum is the environment's reward, under Gymnasium's names."""

    def _rewards(
        self, before: PhysicsState, after: PhysicsState, action: jax.Array
    ) -> dict[str, jax.Array]:
        """The terms of the reward, computed from nothing but what was asked for it."""
        before, after = (
            state.replace(readings={name: state.readings[name] for name in self._readings})
            for state in (before, after)
        )
        return self._reward_terms(before, after, action)

    def _observed(self) -> tuple[Range, ...]:
        """The numbers of ``mjData`` that are observed, each clipped to its limits."""
        return Range("qpos", first=self._num_hidden_positions), Range("qvel")

    def _limits(self) -> tuple[Range, ...]:
        """An episode ends when one of these numbers is no longer strictly within its limits."""
        return ()

    def _terminated(self, physics_state: PhysicsState) -> jax.Array:
        return ~all_within(physics_state, self._limits())

    def _observation(self, physics_state: PhysicsState) -> jax.Array:
        parts = self._observed()
        return jnp.concatenate([jnp.clip(read(physics_state, p), p.low, p.high) for p in parts])

    def _positions(self, physics_state: PhysicsState) -> dict[str, jax.Array]:
        return {"x_position": physics_state.qpos[0]}

    def _initial_velocity(self, key: jax.Array) -> jax.Array:
        noise = self._reset_noise_scale
        return jax.random.uniform(key, (self.physics.model.nv,), minval=-noise, maxval=noise)

    def _normal_velocity(self, key: jax.Array) -> jax.Array:
        return self._reset_noise_scale * jax.random.normal(key, (self.physics.model.nv,))
