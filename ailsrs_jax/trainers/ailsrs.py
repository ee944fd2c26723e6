"""Adversarial imitation learning via random search (Shin and Kim, IJCNN 2019)."""

import dataclasses
from typing import Literal

import jax
import jax.numpy as jnp
from flax import struct

from ailsrs_jax.components import normalizer, random_search
from ailsrs_jax.components.linear_regression import ridge_regression
from ailsrs_jax.components.normalizer import RunningStatistics
from ailsrs_jax.components.policy import KeptPolicy, LinearPolicy, keep
from ailsrs_jax.components.sampling import StepMemory, empty_memory
from ailsrs_jax.data.demonstrations import Demonstrations
from ailsrs_jax.envs import Env
from ailsrs_jax.envs.interface import action_range
from ailsrs_jax.errors import UserError
from ailsrs_jax.trainers import presets
from ailsrs_jax.trainers.parts.adversary import Adversary, AdversarySettings, AdversaryState
from ailsrs_jax.trainers.parts.episodes import Episodes
from ailsrs_jax.trainers.parts.exploration import Exploration, explore
from ailsrs_jax.trainers.parts.reference import Reference, make_reference
from ailsrs_jax.trainers.parts.rollout import Simulator, as_simulator
from ailsrs_jax.trainers.parts.settings import Positive, UpToOne, require_countable, validate
from ailsrs_jax.trainers.parts.trainer import Algorithm, Trainer

Metrics = dict[str, jax.Array]


@dataclasses.dataclass(frozen=True)
class AilsrsSettings(AdversarySettings):
    """Settings of :class:`Ailsrs`; the defaults are the paper's (Table I)."""

    num_iterations: int = 100_000
    num_directions: int = 320
    num_top_directions: int = 320  #: the paper uses all
    step_size: Positive = 0.02
    final_step_size: float = 0.02  #: reached linearly at the last iteration
    noise_std: Positive = 0.03
    episode_length: int = 1000
    memory_iterations: int = 1  #: the discriminator sees the policies of this many iterations
    memory_samples: int = 4000  #: at least this many steps of each iteration are remembered
    #: the worth of a step after an episode's end, as a share of the mean over its live steps: with
    #: 1, the paper's, an episode is worth the mean over its live steps; with 0 their sum, over T
    reward_after_end: UpToOne = 1.0
    behavior_cloning_start: bool = False
    standardize_with: Literal["running", "expert"] = "running"  #: whose statistics
    num_evaluation_episodes: int = 4
    num_distance_samples: int = 1500  #: from each side, for the choice of the policy to keep

    @property
    def steps_per_iteration(self) -> int:
        """Environment steps that an iteration simulates at most."""
        return (2 * self.num_directions + self.num_evaluation_episodes) * self.episode_length


class TrainState(struct.PyTreeNode):
    """The state that one iteration hands to the next."""

    weights: jax.Array  # (p, n)
    statistics: RunningStatistics  # what observations are standardised with
    adversary: AdversaryState
    memory: StepMemory  # discriminator inputs of recent policies
    kept: KeptPolicy  # closest to the expert so far, by energy distance
    key: jax.Array
    iteration: jax.Array  # () int32


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
        statistics = normalizer.init(self.env.observation_size)
        weights = jnp.zeros((self.env.action_size, self.env.observation_size))
        if settings.standardize_with == "expert" or settings.behavior_cloning_start:
            statistics = self.reference.statistics
        if settings.behavior_cloning_start:
            expert = self.reference
            weights = ridge_regression(expert.observations, expert.actions, expert.alive)
        return TrainState(
            weights=weights,
            statistics=statistics,
            adversary=self.adversary.init(network_key),
            memory=empty_memory(
                slots=settings.memory_iterations,
                num_pairs=settings.num_directions,
                steps_each=self._steps_each,
                width=self.adversary.input_size,
            ),
            kept=keep(self.policy(weights, statistics)),
            key=key,
            iteration=jnp.zeros((), jnp.int32),
        )

    def update(self, state: TrainState) -> tuple[TrainState, Metrics]:
        """Run one iteration of the paper's Algorithm 2: ask, simulate, judge, tell.

        The unperturbed policy is evaluated in the same batch. Its episodes decide which policy is
        kept, by their distance to the expert; neither search nor discriminator learn from them.
        """
        keys = jax.random.split(state.key, 6)
        key, ask_key, reset_key, memory_key, adversary_key, distance_key = keys
        policy = self.policy(state.weights, state.statistics)

        deltas = self.ask(ask_key)
        exploration = explore(self.simulator, policy, deltas, reset_key, self.settings)
        memory = self.remember(state.memory, exploration, memory_key)
        adversary, scores = self.adversary.train(state.adversary, adversary_key, memory.sample)
        returns = exploration.pairs(self.judge(adversary, exploration.episodes))
        weights = self.tell(state, deltas, returns)

        evaluation = exploration.evaluation
        distance = self.reference.distance(distance_key, evaluation, self.settings.episode_length)
        metrics = {
            "evaluation_return": evaluation.env_returns.mean(),
            "evaluation_length": evaluation.lengths.mean(),
            "expert_distance": distance,
            "imitation_reward": _mean_of_finite(returns),
            **scores,
            **exploration.episodes.counts(),
        }
        state = TrainState(
            weights=weights,
            statistics=self.merge_states(state.statistics, exploration),
            adversary=adversary,
            memory=memory,
            kept=state.kept.offer(policy, -distance, state.iteration),
            key=key,
            iteration=state.iteration + 1,
        )
        return state, metrics

    def policy(self, weights: jax.Array, statistics: RunningStatistics) -> LinearPolicy:
        """Return the unperturbed policy, with the statistics frozen as they are."""
        return LinearPolicy(weights, statistics.mean, statistics.std, *action_range(self.env))

    def ask(self, key: jax.Array) -> jax.Array:
        """Draw ``deltas (N, p, n)``, the directions in which the policy is perturbed."""
        shape = self.env.action_size, self.env.observation_size
        return random_search.sample_directions(key, self.settings.num_directions, shape)

    def remember(self, memory: StepMemory, exploration: Exploration, key: jax.Array) -> StepMemory:
        """Insert discriminator inputs of k random live steps of each perturbed policy."""
        num_seen = self.adversary.num_seen(exploration.episodes.usable_lengths)[:, None]
        shape = (2, self.settings.num_directions, self._steps_each)
        fractions = jax.random.uniform(key, shape).reshape(-1, self._steps_each)
        fractions = jnp.pad(fractions, [(exploration.num_evaluations, 0), (0, 0)])
        # A fraction just below 1 can round up. Episodes without steps are never sampled, so time 0
        # is a safe placeholder.
        time = jnp.minimum((fractions * num_seen).astype(jnp.int32), jnp.maximum(num_seen - 1, 0))
        inputs = self.adversary.inputs(*exploration.episodes.steps_at(time))
        return memory.insert(exploration.pairs(inputs), exploration.pairs(num_seen.squeeze(1)))

    def judge(self, adversary: AdversaryState, episodes: Episodes) -> jax.Array:
        """Return the imitation return ``(B,)`` of each episode, r̄ (ρ + (1 − ρ) L / T).

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
        lasted = episodes.lengths / self.settings.episode_length
        returns = totals / num_seen * (worth + (1.0 - worth) * lasted)
        return jnp.where(episodes.diverged, jnp.nan, returns)

    def tell(self, state: TrainState, deltas: jax.Array, returns: jax.Array) -> jax.Array:
        """Step along the directions ``deltas`` that had the highest ``returns (2, N)``."""
        settings = self.settings
        # The step size stays at its last value if ``update`` is called more often than planned.
        done = jnp.minimum(state.iteration / max(settings.num_iterations - 1, 1), 1.0)
        return random_search.step(
            state.weights,
            deltas,
            *returns,
            step_size=settings.step_size + done * (settings.final_step_size - settings.step_size),
            num_top_directions=settings.num_top_directions,
        )

    def merge_states(
        self, statistics: RunningStatistics, exploration: Exploration
    ) -> RunningStatistics:
        """Merge the observations of this iteration into what the next one standardises with."""
        if self.settings.standardize_with == "expert":
            return statistics
        observations = exploration.episodes.observations
        return normalizer.update(statistics, observations, exploration.alive)

    @property
    def adversary(self) -> Adversary:
        """The discriminator's functions; its parameters are part of the state."""
        return Adversary(self.settings, self.reference)

    @property
    def _steps_each(self) -> int:
        """Steps remembered of each episode."""
        return -(-self.settings.memory_samples // (2 * self.settings.num_directions))


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
            demonstrations do not hold what the settings need.
    """
    validate(settings)
    if settings.imitation_reward == "airl" and settings.reward_after_end != 1.0:
        raise UserError(
            f"reward_after_end is {settings.reward_after_end}: imitation_reward=airl, which is "
            "negative where the policy is told apart, would reward an early end; set it to 1"
        )
    remembered = 2 * settings.num_directions * settings.memory_iterations
    require_countable((remembered + settings.num_evaluation_episodes) * settings.episode_length)
    reference = make_reference(
        demonstrations, settings.episode_length, settings.num_distance_samples
    )
    Adversary(settings, reference)  # checks that the demonstrations hold what it sees
    if settings.behavior_cloning_start:
        reference.require_actions("behavior_cloning_start")
    return Ailsrs(as_simulator(env), settings, reference)


AILSRS = Algorithm("AILSRS", make_ailsrs, AilsrsSettings, presets.AILSRS, shares_devices=True)


def _mean_of_finite(returns: jax.Array) -> jax.Array:
    mean = returns.mean()
    return jnp.where(jnp.isnan(mean), jnp.nanmean(returns), mean)
