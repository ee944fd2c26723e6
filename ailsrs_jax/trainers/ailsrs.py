"""Adversarial imitation learning via random search (Shin and Kim, IJCNN 2019)."""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
from flax import struct

from ailsrs_jax.components import normalizer, random_search
from ailsrs_jax.components.finite import in_units, mean_of_finite
from ailsrs_jax.components.normalizer import RunningStatistics
from ailsrs_jax.components.policy import KeptPolicy, Layers, keep
from ailsrs_jax.components.sampling import StepMemory, empty_memory, sample_times
from ailsrs_jax.data.demonstrations import Demonstrations
from ailsrs_jax.envs import Env
from ailsrs_jax.trainers import presets
from ailsrs_jax.trainers.parts.adversary import (
    SCORES,
    Adversary,
    AdversaryState,
    adversary_reference,
)
from ailsrs_jax.trainers.parts.ailsrs_settings import AilsrsSettings
from ailsrs_jax.trainers.parts.episodes import Episodes, over_updates, with_evaluation
from ailsrs_jax.trainers.parts.policy_space import PolicySpace
from ailsrs_jax.trainers.parts.reference import Reference, require_sizes
from ailsrs_jax.trainers.parts.rollout import Simulator, Starts, as_simulator
from ailsrs_jax.trainers.parts.settings import (
    is_used,
    parse_entries,
    require_countable,
    validate,
)
from ailsrs_jax.trainers.parts.trainer import Algorithm, Metrics, Trainer

SAMPLES_OF_A_RETURN = 250  # steps of a policy that its energy distance is estimated from


class TrainState(struct.PyTreeNode):
    """The state that one iteration hands to the next."""

    weights: jax.Array  # (p, m + 1), the last column is the intercept
    mean_weights: jax.Array  # (p, m + 1), mean of the iterates
    hidden: Layers  # of a network, which never change; empty for a linear policy, where m = n
    statistics: RunningStatistics  # what observations are standardised with
    adversary: AdversaryState
    memory: StepMemory  # discriminator inputs of recent policies
    kept: KeptPolicy  # by the energy distance to the expert
    key: jax.Array
    iteration: jax.Array  # () int32
    num_updates: jax.Array  # () int32, steps of the search so far
    finished: jax.Array  # () bool, a cycle has ended with a policy close to the expert


@dataclasses.dataclass(frozen=True, eq=False)
class Ailsrs(Trainer):
    """Imitates ``reference`` in an environment; its reward is measured but never used."""

    simulator: Simulator
    settings: AilsrsSettings
    reference: Reference

    def init(self, key: jax.Array) -> TrainState:
        """Start with weights of zero and no statistics, as the paper does; or with a clone."""
        settings = self.settings
        key, network_key = jax.random.split(key)
        hidden = self.space.hidden_layers(jax.random.fold_in(network_key, 1))
        statistics = normalizer.init(self.env.observation_size)
        weights = jnp.zeros(self.space.shape)
        if settings.standardize_with == "expert" or settings.behavior_cloning_start:
            statistics = self.reference.statistics
        if settings.behavior_cloning_start:
            weights = self.space.clone(hidden)
        return TrainState(
            weights=weights,
            mean_weights=weights,
            hidden=hidden,
            statistics=statistics,
            adversary=self.adversary.init(network_key),
            memory=empty_memory(
                slots=settings.memory_iterations,
                num_pairs=settings.num_perturbed // 2,
                steps_each=self._steps_each,
                width=self.adversary.input_size,
            ),
            kept=keep(self.space.policy(weights, hidden, statistics)),
            key=key,
            iteration=jnp.zeros((), jnp.int32),
            num_updates=jnp.zeros((), jnp.int32),
            finished=jnp.zeros((), bool),
        )

    def update(self, state: TrainState) -> tuple[TrainState, Metrics]:
        """Run one iteration: evaluate the policy, then take a few steps of the search.

        The evaluation decides which policy is kept, by its distance to the expert; neither search
        nor discriminator learn from it.
        """
        settings = self.settings
        key, updates_key, evaluation_key, distance_key = jax.random.split(state.key, 4)
        policy = self.space.policy(state.mean_weights, state.hidden, state.statistics)
        evaluation, evaluated = self.evaluate(policy, evaluation_key)
        distance = self.reference.distance(distance_key, evaluation, settings.episode_length)
        evaluated["expert_distance"] = distance
        kept = state.kept.offer(policy, -distance, state.iteration, settings.keep_within)
        if is_used(settings.recentre_beyond):
            is_far = distance > settings.recentre_beyond * -kept.score
            center = self.space.weights(kept.policy)
            state = state.replace(
                weights=jnp.where(is_far, center, state.weights),
                mean_weights=jnp.where(is_far, center, state.mean_weights),
            )
        update_keys = jax.random.split(updates_key, settings.updates_per_iteration)
        state, metrics = jax.lax.scan(self.search, state, update_keys)
        iteration = state.iteration + 1
        at_end = iteration % settings.cycle == 0
        finished = at_end & (-kept.score <= settings.finish_distance)
        state = state.replace(kept=kept, key=key, iteration=iteration, finished=finished)
        return state, with_evaluation(over_updates(metrics), evaluated)

    def search(self, state: TrainState, key: jax.Array) -> tuple[TrainState, Metrics]:
        """Take one step of the search, the paper's Algorithm 2: ask, simulate, judge, tell."""
        ask_key, start_key, memory_key, adversary_key, distance_key = jax.random.split(key, 5)
        # Not placed, XLA would share directions and returns as it does episodes, and gather them.
        deltas = self.simulator.place(self.ask(ask_key))
        episodes = self.simulate(state, deltas, start_key)
        memory = self.remember(state.memory, episodes, memory_key)
        adversary, scores = self.train_adversary(state, memory, adversary_key)
        returns = self.simulator.place(self.judge(adversary, episodes))
        compared = self.simulator.place(self.compare(returns, episodes, distance_key))
        weights = self.tell(state, deltas, compared)
        decay = self.settings.averaging
        metrics = {"imitation_reward": mean_of_finite(returns), **scores, **episodes.counts()}
        state = state.replace(
            weights=weights,
            mean_weights=decay * state.mean_weights + (1.0 - decay) * weights,
            statistics=self.merge_states(state.statistics, episodes),
            adversary=adversary,
            memory=memory,
            num_updates=state.num_updates + 1,
        )
        return state, metrics

    def done(self, state: TrainState) -> jax.Array:
        """Return which part of the cycle is done, from 0 at its first step to 1 at its last."""
        length = self.settings.cycle * self.settings.updates_per_iteration
        return state.num_updates % length / max(length - 1, 1)

    def ask(self, key: jax.Array) -> jax.Array:
        """Draw ``deltas (N, p, m + 1)``, the directions in which the policy is perturbed."""
        shape = self.settings.num_directions, *self.space.shape
        return jax.random.normal(key, shape) * self.space.searched

    def starts(self, key: jax.Array) -> Starts:
        """Draw the starts of the S episodes of each perturbed policy."""
        settings = self.settings
        num_drawn = settings.num_starts if settings.common_starts else settings.num_perturbed
        share = settings.demonstrated_starts
        starts = self.reference.draw_starts(self.env, key, num_drawn, share)
        index = jnp.arange(settings.num_perturbed) % num_drawn
        return jax.tree.map(lambda x: x[index], starts)

    def simulate(self, state: TrainState, deltas: jax.Array, key: jax.Array) -> Episodes:
        """Simulate the S episodes of each ``M + ν δ_i``, then those of each ``M − ν δ_i``."""
        settings = self.settings
        noise_std = settings.noise_std * settings.noise_decay ** self.done(state)
        weights = random_search.perturb(state.weights, deltas, noise_std)
        policies = jax.vmap(lambda w: self.space.policy(w, state.hidden, state.statistics))(weights)
        policies = jax.tree.map(lambda x: jnp.repeat(x, settings.num_starts, axis=0), policies)
        return self.simulator(policies, self.starts(key), settings.perturbed_length)

    def remember(self, memory: StepMemory, episodes: Episodes, key: jax.Array) -> StepMemory:
        """Insert discriminator inputs of k random live steps of each perturbed policy."""
        num_seen = self.adversary.num_seen(episodes.usable_lengths)
        time = sample_times(key, num_seen, self._steps_each)
        inputs = self.adversary.inputs(*episodes.steps_at(time))
        return memory.insert(inputs.reshape(2, -1, *inputs.shape[1:]), num_seen.reshape(2, -1))

    def train_adversary(
        self, state: TrainState, memory: StepMemory, key: jax.Array
    ) -> tuple[AdversaryState, Metrics]:
        """Train the discriminator on what is remembered; longer before the first step."""
        rounds = jnp.where(state.num_updates == 0, self.settings.warmup_rounds, 1)
        done = self.done(state)

        def train(index: jax.Array, trained: tuple[AdversaryState, Metrics]) -> Any:
            round_key = jax.random.fold_in(key, index)
            return self.adversary.train(trained[0], round_key, memory.sample, done)

        untrained = state.adversary, dict.fromkeys(SCORES, jnp.zeros(()))
        result: tuple[AdversaryState, Metrics] = jax.lax.fori_loop(0, rounds, train, untrained)
        return result

    def judge(self, adversary: AdversaryState, episodes: Episodes) -> jax.Array:
        """Return the imitation returns ``(2, N)``, means of r̄ (ρ + (1 − ρ) L / T) over episodes.

        r̄ is the mean reward of its L live steps, and ρ the worth of those after its end. A mean
        over live steps does not see a fall. A sum of positive rewards pays a policy for standing
        still. Between the two, both lose. The return of an episode that diverged is NaN.
        """
        num_seen = self.adversary.num_seen(episodes.usable_lengths)
        totals = episodes.sum_over_steps(
            lambda *steps: self.adversary.rewards(adversary, self.adversary.inputs(*steps)),
            num_seen,
        )
        worth = self.settings.reward_after_end
        lasted = episodes.lengths / self.settings.perturbed_length
        returns = totals / num_seen * (worth + (1.0 - worth) * lasted)
        returns = jnp.where(episodes.diverged, jnp.nan, returns)
        return returns.reshape(2, -1, self.settings.num_starts).mean(axis=-1)

    def compare(self, returns: jax.Array, episodes: Episodes, key: jax.Array) -> jax.Array:
        """Give the energy distance to the expert its share of the ``returns (2, N)``.

        Both parts are in units of their standard deviation over the policies.
        """
        settings, share = self.settings, self.settings.energy_share
        if not is_used(share):
            return returns
        num_groups, limit = 2 * settings.num_directions, settings.perturbed_length
        distances = self.reference.distances(
            key, episodes, limit, num_groups, SAMPLES_OF_A_RETURN
        ).reshape(2, -1)
        return (1.0 - share) * in_units(returns) - share * in_units(distances)

    def tell(self, state: TrainState, deltas: jax.Array, returns: jax.Array) -> jax.Array:
        """Step along the directions ``deltas`` that had the highest ``returns (2, N)``."""
        settings, done = self.settings, self.done(state)
        return random_search.step(
            state.weights,
            deltas,
            *returns,
            step_size=settings.step_size + done * (settings.final_step_size - settings.step_size),
            num_top_directions=settings.num_top_directions,
        )

    def merge_states(self, statistics: RunningStatistics, episodes: Episodes) -> RunningStatistics:
        """Merge the observations of this update into what the next one standardises with."""
        if self.settings.standardize_with == "expert":
            return statistics
        return normalizer.update(statistics, episodes.observations, episodes.usable)

    @property
    def space(self) -> PolicySpace:
        """The policies that the search can reach."""
        return PolicySpace(self.env, self.settings, self.reference)

    @property
    def adversary(self) -> Adversary:
        """The discriminator's functions; its parameters are part of the state."""
        return Adversary(self.settings, self.reference)

    @property
    def _steps_each(self) -> int:
        """Steps remembered of each episode."""
        return -(-self.settings.memory_samples // self.settings.num_perturbed)


def make_ailsrs(
    env: Env | Simulator, demonstrations: Demonstrations, settings: AilsrsSettings
) -> Ailsrs:
    """Prepare the demonstrations for training in ``env``; see :class:`Ailsrs`.

    >>> import ailsrs_jax as ail
    >>> import jax
    >>> env = ail.make_env("swimmer", "mujoco")
    >>> demonstrations = ail.demonstrate(ail.load_expert("swimmer"), 2, env=env, episode_length=50)
    >>> settings = ail.AilsrsSettings(
    ...     num_iterations=2, num_directions=2, num_top_directions=1, episode_length=50
    ... )
    >>> trainer = ail.make_ailsrs(env, demonstrations, settings)
    >>> state, metrics = jax.jit(trainer.train)(jax.random.key(0))
    >>> metrics["evaluation_return"].shape
    (2,)

    Raises:
        UserError: a setting makes no sense, there are too many steps to count, or the
            demonstrations do not fit the environment or lack what the settings need.
    """
    validate(settings)
    settings.require_consistent()
    remembered = settings.num_perturbed * settings.memory_iterations * settings.perturbed_length
    require_countable(remembered + settings.steps_per_iteration)
    simulator = as_simulator(env)
    require_sizes(demonstrations, simulator.env)
    reference = adversary_reference(demonstrations, settings)
    if is_used(settings.energy_share):
        reference.require_comparable(settings.perturbed_length, settings.episode_length)
    parse_entries(settings.policy_entries, reference.observations.shape[-1])
    return Ailsrs(simulator, settings, reference)


AILSRS = Algorithm("AILSRS", make_ailsrs, AilsrsSettings, presets.AILSRS, shares_devices=True)
