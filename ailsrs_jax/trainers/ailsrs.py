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
from ailsrs_jax.trainers.parts.adversary import Adversary, AdversarySettings, AdversaryState
from ailsrs_jax.trainers.parts.devices import EVERYWHERE, ONE_DEVICE, Devices, shared
from ailsrs_jax.trainers.parts.exploration import count_episodes, explore
from ailsrs_jax.trainers.parts.reference import Reference, make_reference
from ailsrs_jax.trainers.parts.rollout import Episodes
from ailsrs_jax.trainers.parts.settings import Positive, UpToOne, require_countable, validate
from ailsrs_jax.trainers.parts.trainer import Trainer

Metrics = dict[str, jax.Array]


@dataclasses.dataclass(frozen=True)
class AilsrsSettings(AdversarySettings):
    """Settings of :class:`Ailsrs`; the defaults are the paper's (Table I)."""

    num_iterations: int = 100_000
    num_directions: int = 320
    num_top_directions: int = 320  #: the paper uses all
    step_size: Positive = 0.02
    final_step_size: float = 0.02  #: reached linearly at the last iteration, whatever the first is
    noise_std: Positive = 0.03
    episode_length: int = 1000
    memory_iterations: int = 1  #: the discriminator sees the policies of so many iterations
    memory_samples: int = 4000  #: at least so many are remembered of each iteration
    #: What a step after an episode's end is worth, as a share of the mean over its live steps. At
    #: 1, the paper's, a rollout is worth the mean over its live steps; at 0 their sum, over T.
    reward_after_end: UpToOne = 1.0
    behavior_cloning_start: bool = False
    standardize_with: Literal["running", "expert"] = "running"  #: whose statistics
    num_evaluation_episodes: int = 4
    num_distance_samples: int = 1500  #: from each side, for the choice of the policy to keep


class TrainState(struct.PyTreeNode):
    """What one iteration hands to the next."""

    weights: jax.Array  # (p, n)
    statistics: RunningStatistics  # what observations are standardised with
    adversary: AdversaryState
    memory: StepMemory  # discriminator inputs of recent policies
    kept: KeptPolicy  # closest to the expert so far, by energy distance
    key: jax.Array
    iteration: jax.Array  # () int32


# Where each part of the state is: each device remembers steps of its own episodes only.
STATE_SPECS = TrainState(
    weights=EVERYWHERE,
    statistics=EVERYWHERE,
    adversary=EVERYWHERE,
    memory=StepMemory(steps=shared(axis=2), lengths=EVERYWHERE, num_inserted=EVERYWHERE),
    kept=EVERYWHERE,
    key=EVERYWHERE,
    iteration=EVERYWHERE,
)


@dataclasses.dataclass(frozen=True, eq=False)
class Ailsrs(Trainer):
    """Imitates ``expert`` in ``env``, whose reward is measured but never used.

    Directions are shared by ``devices``, and each simulates ``rollout_batch_size`` episodes at a
    time, by default all of its share; the results depend on neither but by rounding.
    """

    env: Env
    settings: AilsrsSettings
    reference: Reference
    devices: Devices = ONE_DEVICE
    rollout_batch_size: int | None = None

    def init(self, key: jax.Array) -> TrainState:
        """The paper's start, all weights zero and no statistics; or behaviour cloning's."""
        return self.devices.split(self._init, STATE_SPECS, EVERYWHERE)(key)

    def update(self, state: TrainState) -> tuple[TrainState, Metrics]:
        """One iteration of the paper's Algorithm 2.

        The unperturbed policy's evaluation episodes are simulated in the same batch. They measure
        its distance to the expert, which decides what to keep, and its return, for people to see;
        neither the search nor the discriminator learns from them.
        """
        return self.devices.split(self._update, (STATE_SPECS, EVERYWHERE), STATE_SPECS)(state)

    def policy(self, weights: jax.Array, statistics: RunningStatistics) -> LinearPolicy:
        """The unperturbed policy, with statistics frozen as they are."""
        return LinearPolicy(weights, statistics.mean, statistics.std, *action_range(self.env))

    def _init(self, key: jax.Array) -> TrainState:
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
            adversary=self._adversary.init(network_key),
            memory=empty_memory(
                slots=settings.memory_iterations,
                num_pairs=settings.num_directions,
                num_here=settings.num_directions // self.devices.count,
                steps_each=self._steps_each,
                width=self._adversary.input_size,
            ),
            kept=keep(self.policy(weights, statistics)),
            key=key,
            iteration=jnp.zeros((), jnp.int32),
        )

    def _update(self, state: TrainState) -> tuple[TrainState, Metrics]:
        """:meth:`update` on one device. All of the state but the memory's steps is everywhere."""
        settings, devices = self.settings, self.devices
        num_evaluations = settings.num_evaluation_episodes
        keys = jax.random.split(state.key, 6)
        key, noise_key, reset_key, memory_key, discriminator_key, distance_key = keys

        # 1. Roll out the 2N perturbed policies, and the unperturbed one a few times.
        policy = self.policy(state.weights, state.statistics)
        deltas = random_search.sample_directions(
            noise_key, settings.num_directions, state.weights.shape
        )
        batch = explore(
            self.env,
            policy,
            deltas,
            reset_key,
            noise_std=settings.noise_std,
            num_evaluation_episodes=num_evaluations,
            episode_length=settings.episode_length,
            devices=devices,
            batch_size=self.rollout_batch_size,
        )

        # 2. Train the discriminator to tell their steps from the expert's.
        lengths = devices.gather(batch.usable_lengths[num_evaluations:].reshape(2, -1), axis=1)
        memory = state.memory.insert(
            self._sample_inputs(memory_key, batch), self._adversary.num_seen(lengths)
        )
        adversary, adversary_metrics = self._adversary.train(
            state.adversary,
            discriminator_key,
            lambda key, size: memory.sample(key, size, devices.first(memory.lengths, axis=2)),
        )

        # 3. Let it judge every rollout, and 4. step along the directions it liked.
        returns = self._imitation_returns(adversary, batch)[num_evaluations:]
        returns_plus, returns_minus = devices.gather(returns.reshape(2, -1), axis=1)
        weights = random_search.step(
            state.weights,
            deltas,
            returns_plus,
            returns_minus,
            step_size=self._step_size(state.iteration),
            num_top_directions=settings.num_top_directions,
        )

        # 5. Merge the states met into the statistics that the next iteration standardises with.
        statistics = state.statistics
        if settings.standardize_with == "running":
            statistics = normalizer.update(
                statistics, batch.observations, batch.alive_from(num_evaluations), devices.sum
            )

        evaluation = batch.episodes(0, num_evaluations)
        # Beside other episodes on each device, which can change the last bits.
        evaluated = devices.agree(
            {
                "evaluation_return": evaluation.env_returns.mean(),
                "evaluation_length": evaluation.lengths.mean(),
                "expert_distance": self.reference.distance(
                    distance_key, evaluation, settings.episode_length
                ),
            }
        )
        all_returns = jnp.stack([returns_plus, returns_minus])
        mean_return = all_returns.mean()
        metrics = {
            **evaluated,
            "imitation_reward": jnp.where(
                jnp.isnan(mean_return), jnp.nanmean(all_returns), mean_return
            ),
            **adversary_metrics,
            **count_episodes(batch, num_evaluations, devices),
        }
        state = TrainState(
            weights=weights,
            statistics=statistics,
            adversary=adversary,
            memory=memory,
            kept=state.kept.offer(policy, -evaluated["expert_distance"], state.iteration),
            key=key,
            iteration=state.iteration + 1,
        )
        return state, metrics

    @property
    def _adversary(self) -> Adversary:
        return Adversary(self.settings, self.reference, self.devices)

    @property
    def _steps_each(self) -> int:
        """Steps remembered of each episode."""
        return -(-self.settings.memory_samples // (2 * self.settings.num_directions))

    def _step_size(self, iteration: jax.Array) -> jax.Array:
        settings = self.settings
        # Whoever calls `update` more often stays at the last, and does not step backwards.
        done = jnp.minimum(iteration / max(settings.num_iterations - 1, 1), 1.0)
        return settings.step_size + done * (settings.final_step_size - settings.step_size)

    def _sample_inputs(self, key: jax.Array, batch: Episodes) -> jax.Array:
        """``(2, N', k, d)`` discriminator inputs of k live steps of each perturbed policy."""
        shape = (2, self.settings.num_directions, self._steps_each)
        fractions = self.devices.mine(jax.random.uniform(key, shape), axis=1)
        fractions = fractions.reshape(-1, self._steps_each)
        first = self.settings.num_evaluation_episodes
        num_seen = self._adversary.num_seen(batch.usable_lengths[first:, None])
        # A fraction just below 1 can round up. Of no steps any zero will do: it is never drawn.
        time = jnp.minimum((fractions * num_seen).astype(jnp.int32), jnp.maximum(num_seen - 1, 0))
        episode = first + jnp.arange(len(time))[:, None]
        following = batch.observations.at[episode, time + 1].get(mode="fill", fill_value=0.0)
        inputs = self._adversary.inputs(
            batch.observations[episode, time], batch.actions[episode, time], following
        )
        return inputs.reshape(2, -1, *inputs.shape[1:])

    def _imitation_returns(self, adversary: AdversaryState, episodes: Episodes) -> jax.Array:
        """``(B,)`` reward of each rollout, r̄ (ρ + (1 − ρ) L / T); NaN of one that diverged.

        r̄ is the mean over its L live steps, and ρ what those after its end are worth. A mean over
        live steps cannot see a fall, and their sum of positive rewards pays a policy for standing
        still; between the two both lose.
        """
        num_seen = self._adversary.num_seen(episodes.usable_lengths)
        totals = episodes.sum_over_steps(
            lambda *steps: self._adversary.rewards(adversary, self._adversary.inputs(*steps)),
            num_seen,
        )
        worth = self.settings.reward_after_end
        lasted = episodes.lengths / self.settings.episode_length
        returns = totals / num_seen * (worth + (1.0 - worth) * lasted)
        return jnp.where(episodes.diverged, jnp.nan, returns)


def make_ailsrs(
    env: Env,
    demonstrations: Demonstrations,
    settings: AilsrsSettings,
    devices: Devices = ONE_DEVICE,
    rollout_batch_size: int | None = None,
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
        UserError: a setting makes no sense, the directions cannot be shared evenly, there are too
            many steps to count, or the demonstrations do not hold what the settings need.
    """
    validate(settings)
    if settings.imitation_reward == "airl" and settings.reward_after_end != 1.0:
        raise UserError(
            f"reward_after_end is {settings.reward_after_end}: imitation_reward=airl, which is "
            "negative where the policy is told apart, would reward an early end; set it to 1"
        )
    devices.require_share(settings.num_directions)
    remembered = 2 * settings.num_directions * settings.memory_iterations
    require_countable((remembered + settings.num_evaluation_episodes) * settings.episode_length)
    expert = make_reference(demonstrations, settings.episode_length, settings.num_distance_samples)
    Adversary(settings, expert)  # checks that the demonstrations hold what it sees
    if settings.behavior_cloning_start:
        expert.require_actions("behavior_cloning_start")
    return Ailsrs(env, settings, expert, devices, rollout_batch_size)
