"""The settings of AILSRS."""

import dataclasses
from typing import Literal

from ailsrs_jax.errors import UserError
from ailsrs_jax.trainers.parts.adversary import AdversarySettings
from ailsrs_jax.trainers.parts.settings import (
    Entries,
    FromOne,
    FromZero,
    Positive,
    PositiveUpToOne,
    UpToOne,
    is_used,
)


@dataclasses.dataclass(frozen=True)
class AilsrsSettings(AdversarySettings):
    """Settings of :class:`~ailsrs_jax.trainers.ailsrs.Ailsrs`.

    The defaults are the paper's (Table I).
    """

    num_iterations: int = 100_000
    #: iterations of a cycle, the schedule of step size, noise and penalty; 0: all are one cycle
    cycle_iterations: FromZero = 0
    #: training ends after a cycle if the distance of the kept policy is at most this
    finish_distance: Positive = 0.3
    updates_per_iteration: int = 1  #: steps of the search between two evaluations
    num_directions: int = 320
    num_top_directions: FromZero = 320  #: 0: all, as in the paper
    step_size: Positive = 0.02
    final_step_size: float = 0.02  #: reached linearly at the end of a cycle
    noise_std: Positive = 0.03
    noise_decay: PositiveUpToOne = 1.0  #: the share of ``noise_std`` that is left then
    episode_length: int = 1000  #: the time limit of an evaluation
    search_length: FromZero = 0  #: the time limit of a perturbed policy; 0: ``episode_length``
    num_starts: int = 1  #: episodes of each perturbed policy in an update
    common_starts: bool = False  #: all perturbed policies of an update start at the same states
    demonstrated_starts: UpToOne = 0.0  #: the share of starts that are demonstrated states
    warmup_rounds: int = 1  #: of ``discriminator_steps`` before the first step of the search
    memory_iterations: int = 1  #: the discriminator sees the policies of this many updates
    memory_samples: int = 4000  #: at least this many steps of each update are remembered
    #: the worth of a step after an episode's end, as a share of the mean over its live steps: with
    #: 1, the paper's, an episode is worth the mean over its live steps; with 0 their sum, over T
    reward_after_end: UpToOne = 1.0
    energy_share: UpToOne = 0.0  #: of the energy distance to the expert in a policy's return
    behavior_cloning_start: bool = False
    intercept: bool = False  #: of the policy; it is cloned and searched, too
    #: mlp: a network of tanh units; it is cloned, and the search changes its last layer
    policy: Literal["linear", "mlp"] = "linear"
    policy_entries: Entries = "all"  #: of the observation, such as 0:27
    standardize_with: Literal["running", "expert"] = "running"  #: whose statistics
    averaging: UpToOne = 0.0  #: decay, each update, of the mean of the iterates; 0: the iterate
    #: times the distance of the kept policy: after an evaluation with a larger distance, the search
    #: goes on from the kept policy; 0: never
    recentre_beyond: float = 0.0
    #: times the smallest distance: a later policy that is nearer than this is kept instead
    keep_within: FromOne = 1.0
    num_evaluation_episodes: int = 4
    num_distance_samples: int = 1500  #: from each side, for the choice of the policy to keep

    @property
    def cycle(self) -> int:
        """Iterations of a cycle."""
        return min(self.cycle_iterations or self.num_iterations, self.num_iterations)

    @property
    def perturbed_length(self) -> int:
        """The time limit of a perturbed policy's episode, in environment steps."""
        return min(self.search_length or self.episode_length, self.episode_length)

    @property
    def num_perturbed(self) -> int:
        """Episodes of perturbed policies in an update."""
        return 2 * self.num_directions * self.num_starts

    @property
    def steps_per_iteration(self) -> int:
        """Environment steps that an iteration simulates at most."""
        search = self.updates_per_iteration * self.num_perturbed * self.perturbed_length
        return search + self.num_evaluation_episodes * self.episode_length

    def require_consistent(self) -> None:
        """Raise UserError if two settings do not go together."""
        if self.imitation_reward == "airl" and self.reward_after_end != 1.0:
            raise UserError(
                f"reward_after_end is {self.reward_after_end}: imitation_reward=airl, which is "
                "negative where the policy is told apart, would reward an early end; set it to 1"
            )
        if self.policy == "mlp" and not self.behavior_cloning_start:
            raise UserError(
                "policy=mlp needs behavior_cloning_start=true: the search changes only the last "
                "layer of the cloned network"
            )
        if is_used(self.recentre_beyond) and self.standardize_with == "running":
            raise UserError(
                "recentre_beyond needs standardize_with=expert: running statistics have changed "
                "what the weights of the kept policy do"
            )
