"""Simulate whole episodes of a batch of policies."""

import dataclasses
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from ailsrs_jax.components.policy import LinearPolicy, MlpPolicy, Policy, repeated
from ailsrs_jax.envs import Env, State
from ailsrs_jax.envs.divergence import has_diverged
from ailsrs_jax.envs.gymnasium_env import GymnasiumStart
from ailsrs_jax.envs.interface import has_own
from ailsrs_jax.envs.physics import InitialState, Perceptrons
from ailsrs_jax.envs.physics.base import LARGEST
from ailsrs_jax.trainers.parts.episodes import Episodes, empty_episodes
from ailsrs_jax.trainers.parts.sharing import AXIS, shared
from ailsrs_jax.trainers.parts.slots import simulate_in_slots

Starts = jax.Array | InitialState | GymnasiumStart


@dataclasses.dataclass(frozen=True)
class Simulator:
    """Simulates episodes in ``env``; all that trainers know of simulation and of devices.

    The devices of ``mesh`` share the episodes of a batch, and each simulates ``batch_size`` of its
    share at a time, by default all. The episodes depend on neither, except for rounding.
    """

    env: Env
    mesh: Mesh | None = None  # with the one axis ``AXIS``
    batch_size: int | None = None

    @property
    def num_devices(self) -> int:
        """How many devices share the episodes."""
        return 1 if self.mesh is None else self.mesh.size

    @property
    def everywhere(self) -> NamedSharding | None:
        """The sharding of training states, ``out_shardings`` of ``jax.jit``: a copy on each device.

        Without it XLA may leave a part of a state on each device.
        """
        return None if self.mesh is None else NamedSharding(self.mesh, PartitionSpec())

    def place(self, tree: Any) -> Any:
        """Copy the arrays of ``tree`` to all devices."""
        sharding = self.everywhere
        return tree if sharding is None else jax.lax.with_sharding_constraint(tree, sharding)

    def __call__(
        self,
        policies: Policy,
        starts: Starts,
        episode_length: int,
        noise: jax.Array | None = None,
    ) -> Episodes:
        """Simulate one episode of each policy; see :func:`simulate`."""
        if self.mesh is None:
            return simulate(self.env, policies, starts, episode_length, self.batch_size, noise)
        mesh = self.mesh

        # The merged axis of all seeds is shared: a vmapped jax.shard_map has empty arguments again.
        @merge_vmapped_axis
        def on_devices(policies: Policy, starts: Starts, noise: jax.Array | None) -> Episodes:
            num_episodes = len(policies.mean)
            inputs = (policies, starts, noise)
            if not (num_missing := -num_episodes % mesh.size):
                return shared(share, mesh, specs)(*inputs)
            # A batch that does not divide evenly is filled up with copies of its last episode.
            index = jnp.minimum(jnp.arange(num_episodes + num_missing), num_episodes - 1)
            episodes = shared(share, mesh, specs)(*jax.tree.map(lambda x: x[index], inputs))
            return jax.tree.map(lambda x: x[:num_episodes] if x.ndim else x, episodes)

        def share(policies: Policy, starts: Starts, noise: jax.Array | None) -> Episodes:
            mine = simulate(self.env, policies, starts, episode_length, self.batch_size, noise)
            return mine.replace(slot_steps=jax.lax.psum(mine.slot_steps, AXIS))

        part: Any = PartitionSpec(AXIS)
        whole: Any = PartitionSpec()
        specs = Episodes(part, part, part, part, part, part, slot_steps=whole)
        episodes: Episodes = on_devices(policies, starts, noise)
        return episodes.replace(mesh=self.mesh)

    def evaluate(
        self, policy: Policy, key: jax.Array, num_episodes: int, episode_length: int
    ) -> Episodes:
        """Simulate ``num_episodes`` episodes of one policy, from initial states of the task."""
        policies, starts = repeated(policy, num_episodes), jax.random.split(key, num_episodes)
        return self(policies, starts, episode_length)


def as_simulator(env: Env | Simulator) -> Simulator:
    """Return a simulator of ``env`` on the default device, or ``env`` itself if it is one."""
    return env if isinstance(env, Simulator) else Simulator(env)


def simulate(
    env: Env,
    policies: Policy,
    starts: Starts,
    episode_length: int,
    batch_size: int | None = None,
    noise: jax.Array | None = None,
) -> Episodes:
    """Simulate one episode of each policy.

    MuJoCo's C engine runs whole episodes, each on one thread, and Gymnasium's environments do so in
    worker processes; ``batch_size`` has no effect there.
    Elsewhere all episodes are stepped together, in a loop that ends when the last episode does.
    An episode also ends where it diverges, before the step that is not finite
    (:mod:`~ailsrs_jax.envs.divergence`).

    Under ``jax.vmap`` the new axis is merged into the batch, so that several seeds still are one
    loop with one batch of simulations; XLA's own rule would copy the whole trajectory at every
    step. ``slot_steps`` is then the number of all of them together.

    Args:
        env: a Brax environment without auto-reset; ``done`` ends an episode.
        policies: a batch of B policies.
        starts: of each episode: ``(B,)`` keys of the initial states; or what ``env.draw_start`` or
            ``env.state_at`` returns, for MuJoCo tasks and Gymnasium's environments.
        episode_length: T, the time limit in environment steps.
        batch_size: simulations at a time; by default all B. See
            :mod:`~ailsrs_jax.trainers.parts.slots`.
        noise: ``(B, T, p)``, added to the actions before they are clipped.
    """

    @merge_vmapped_axis
    def of_all(policies: Policy, starts: Starts, noise: jax.Array | None) -> Episodes:
        if has_own(env, "runs_episodes") and isinstance(policies, LinearPolicy | MlpPolicy):
            return _run_whole(env, policies, starts, noise, episode_length)
        reset = env.start if isinstance(starts, InitialState) else env.reset
        initial = jax.vmap(reset)(starts)
        if batch_size is None or batch_size >= len(initial.obs):
            return _simulate(env, policies, initial, noise, episode_length)
        return simulate_in_slots(env, policies, initial, noise, episode_length, batch_size)

    episodes: Episodes = of_all(policies, starts, noise)
    return episodes


def merge_vmapped_axis(function: Callable[..., Any]) -> Callable[..., Any]:
    """Make ``jax.vmap`` merge its new axis into the first axis of the arrays of ``function``.

    ``function`` takes and returns pytrees of arrays that have the same first axis; a scalar in the
    result is the same for all.
    """
    merged = jax.custom_batching.custom_vmap(function)

    @merged.def_vmap
    def _of_many(axis_size: int, in_batched: Any, *arguments: Any) -> tuple[Any, Any]:
        def merge(batched: bool, x: jax.Array) -> jax.Array:
            x = x if batched else jnp.broadcast_to(x, (axis_size, *x.shape))
            return x.reshape(x.shape[0] * x.shape[1], *x.shape[2:])  # may hold nothing

        def split(x: jax.Array) -> jax.Array:
            if x.ndim == 0:
                return jnp.broadcast_to(x, axis_size)
            return x.reshape(axis_size, len(x) // axis_size, *x.shape[1:])

        results = merged(*jax.tree.map(merge, tuple(in_batched), arguments))
        results = jax.tree.map(split, results)
        return results, jax.tree.map(lambda _: True, results)

    return merged


def _run_whole(
    env: Any,
    policies: Policy,
    starts: Starts,
    noise: jax.Array | None,
    episode_length: int,
) -> Episodes:
    """Let the environment run whole episodes; see ``MujocoTask.run_episodes``."""
    if isinstance(starts, jax.Array):
        starts = jax.vmap(env.draw_start)(starts)
    num_episodes, num_actions = policies.action_low.shape
    if noise is None:
        noise = jnp.zeros((num_episodes, 0, num_actions))
    run, rewards = env.run_episodes(perceptrons_of(policies), starts, noise, episode_length)
    time = jnp.arange(episode_length)
    # Comparisons with NaN are false.
    absurd = (time < run.lengths[:, None]) & ~(jnp.abs(rewards) <= LARGEST)
    lengths = jnp.where(absurd.any(axis=1), absurd.argmax(axis=1), run.lengths)
    diverged = run.diverged | absurd.any(axis=1)
    rewards = jnp.where(time < lengths[:, None], rewards, 0.0)
    return Episodes(
        observations=run.observations,
        actions=run.actions,
        env_rewards=jnp.where(diverged[:, None] & (time == lengths[:, None]), jnp.nan, rewards),
        lengths=lengths,
        diverged=diverged,
        final_observations=run.final_observations,
        slot_steps=run.lengths.sum(),
    )


def perceptrons_of(policies: Policy) -> Perceptrons:
    """Return a batch of policies as simulators on the host take them."""
    weights, biases = policies.layers
    parameters = [
        array.reshape(len(array), -1)
        for matrix, bias in zip(weights, biases, strict=True)
        for array in (matrix.swapaxes(1, 2), bias)
    ]
    return Perceptrons(
        jnp.concatenate(parameters, axis=1),
        policies.mean,
        policies.std,
        policies.action_low,
        policies.action_high,
        sizes=(policies.mean.shape[1], *(bias.shape[1] for bias in biases)),
    )


def _simulate(
    env: Env,
    policies: Policy,
    initial: State,
    noise: jax.Array | None,
    episode_length: int,
) -> Episodes:
    """Simulate all episodes at once, step by step."""
    episodes = empty_episodes(policies, initial.obs, episode_length)

    def advance(carry: tuple[Any, jax.Array, Episodes]) -> tuple[Any, jax.Array, Episodes]:
        state, time, episodes = carry
        alive = state.done == 0
        inputs = [state.obs] if noise is None else [state.obs, noise[:, time]]
        actions = jax.vmap(lambda policy, *inputs: policy(*inputs))(policies, *inputs)
        after = jax.vmap(env.step)(state, actions)
        diverged = alive & jax.vmap(has_diverged)(state, actions, after)
        usable = alive & ~diverged

        def record(buffer: jax.Array, values: jax.Array, where: jax.Array) -> jax.Array:
            where = where.reshape(-1, *[1] * (values.ndim - 1))
            return buffer.at[:, time].set(jnp.where(where, values, 0.0))

        rewards = jnp.where(diverged, jnp.nan, after.reward)
        episodes = episodes.replace(
            observations=record(episodes.observations, state.obs, usable),
            actions=record(episodes.actions, actions, usable),
            env_rewards=record(episodes.env_rewards, rewards, alive),
            lengths=episodes.lengths + usable,
            diverged=episodes.diverged | diverged,
            final_observations=jnp.where(usable[:, None], after.obs, episodes.final_observations),
            slot_steps=episodes.slot_steps + len(alive),
        )
        over = ~usable | (after.done != 0)
        return after.replace(done=over.astype(after.done.dtype)), time + 1, episodes

    def anyone_alive(carry: tuple[Any, jax.Array, Episodes]) -> jax.Array:
        state, time, _ = carry
        return (time < episode_length) & jnp.any(state.done == 0)

    start = initial.replace(done=jnp.zeros_like(initial.done)), jnp.zeros((), jnp.int32), episodes
    *_, episodes = jax.lax.while_loop(anyone_alive, advance, start)
    return episodes
