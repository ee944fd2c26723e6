"""Episodes that diverge, from the rollout to a run on disk."""

import csv
import math
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.sharding import Mesh

import ailsrs_jax as ail
from ailsrs_jax.components.policy import LinearPolicy
from ailsrs_jax.data.demonstrations import Demonstrations
from ailsrs_jax.trainers.ailsrs import make_ailsrs
from ailsrs_jax.trainers.ars import ArsSettings, make_ars
from ailsrs_jax.trainers.behavior_cloning import BehaviorCloningSettings, make_behavior_cloning
from ailsrs_jax.trainers.gail import GailSettings, make_gail
from ailsrs_jax.trainers.parts import segments
from ailsrs_jax.trainers.parts.ailsrs_settings import AilsrsSettings
from ailsrs_jax.trainers.parts.episodes import Episodes
from ailsrs_jax.trainers.parts.rollout import Simulator, simulate
from ailsrs_jax.trainers.parts.sharing import AXIS
from ailsrs_jax.trainers.trpo import TrpoSettings, make_trpo
from tests.exploding import FINITE_STEPS, ExplodingPointMass, StiffSlider
from tests.point_mass import EPISODE_LENGTH, PointMass, expert_policy, linear_policy, noise
from tests.trainers.parts.test_segments import some_policy

NUM_EPISODES = 100
SEARCH: dict[str, Any] = {"num_iterations": 4, "num_directions": 50, "num_top_directions": 25}
ADVERSARY: dict[str, Any] = {
    "discriminator_batch_size": 64,
    "num_distance_samples": 100,
    "episode_length": EPISODE_LENGTH,
}
BATCHES: dict[str, Any] = {
    "num_iterations": 4,
    "updates_per_iteration": 2,
    "num_envs": 16,
    "batch_size": 640,
    "num_evaluation_episodes": 8,
}


def gentle_policies() -> LinearPolicy:
    """Weak enough that no episode but the unstable ones ends early."""
    weights = 0.05 * jax.random.normal(jax.random.key(0), (NUM_EPISODES, 1, 2))
    return expert_policy().with_weights(weights + expert_policy().weights)


@pytest.mark.parametrize(("place", "batch_size"), [("obs", None), ("obs", 16), ("reward", None)])
def test_a_rollout_ends_before_it_diverges(
    place: str, batch_size: int | None, point_mass: PointMass
) -> None:
    keys = jax.random.split(jax.random.key(3), NUM_EPISODES)

    def all_in(env: PointMass) -> Episodes:
        return simulate(env, gentle_policies(), keys, EPISODE_LENGTH, batch_size)

    plain = jax.jit(lambda: all_in(point_mass))()
    exploding = jax.jit(lambda value: all_in(ExplodingPointMass(0.3, value, place)))
    for value in (math.nan, math.inf, -math.inf, 1.1e10):
        require_an_early_end(exploding(value), plain)


def require_an_early_end(result: Episodes, plain: Episodes) -> None:
    unstable = np.asarray(plain.observations[:, 0, 0] < -0.4)
    assert 15 < unstable.sum() < 45
    np.testing.assert_array_equal(result.diverged, unstable)
    np.testing.assert_array_equal(result.lengths, np.where(unstable, FINITE_STEPS, EPISODE_LENGTH))
    np.testing.assert_array_equal(result.usable_lengths, np.where(unstable, 0, EPISODE_LENGTH))
    np.testing.assert_array_equal(np.isnan(result.env_returns), unstable)
    # The others are what they would be without the unstable ones beside them.
    for name in ("observations", "actions", "env_rewards", "lengths"):
        ours, theirs = np.asarray(getattr(result, name)), np.asarray(getattr(plain, name))
        np.testing.assert_array_equal(ours[~unstable], theirs[~unstable])
    for buffer in (result.observations, result.actions):
        assert np.isfinite(buffer).all()
        assert not buffer[unstable, FINITE_STEPS:].any()
    assert np.abs(result.observations[unstable, FINITE_STEPS - 1]).max() > 100.0
    assert int(result.env_steps) == int(result.lengths.sum())


def test_an_initial_state_that_is_not_finite_leaves_no_step() -> None:
    class NeverFinite(PointMass):
        def reset(self, rng):
            return super().reset(rng).replace(obs=jnp.array([0.0, -jnp.inf]))

    keys = jax.random.split(jax.random.key(0), NUM_EPISODES)
    result = simulate(NeverFinite(), gentle_policies(), keys, 10)
    assert result.diverged.all()
    assert not result.lengths.any()
    assert not result.observations.any()


def learners(demonstrations: Demonstrations) -> dict[str, Any]:
    """What makes the trainer of each algorithm, of an environment."""
    ars = ArsSettings(**SEARCH, episode_length=EPISODE_LENGTH)
    ailsrs = AilsrsSettings(
        **SEARCH,
        **ADVERSARY,
        discriminator_sees="state_next_state",
        gradient_penalty=1.0,
        memory_samples=200,
    )
    gail, trpo = GailSettings(**BATCHES, **ADVERSARY), TrpoSettings(**BATCHES)
    cloning = BehaviorCloningSettings(num_iterations=4, num_evaluation_episodes=20)
    return {
        "ailsrs": lambda env: make_ailsrs(env, demonstrations, ailsrs),
        "ars": lambda env: make_ars(env, ars),
        "gail": lambda env: make_gail(env, demonstrations, gail),
        "trpo": lambda env: make_trpo(env, trpo),
        "bc": lambda env: make_behavior_cloning(env, demonstrations, cloning),
    }


def require_finite(state: Any) -> None:
    """All that is learned, of a state or of all states of a run."""
    learned = [getattr(state, name, None) for name in ("weights", "adversary", "actor_critic")]
    learned += [getattr(state, "statistics", None), state.kept.policy, getattr(state, "memory", 0)]
    for leaf in jax.tree.leaves(learned):
        assert np.isfinite(leaf).all()


@pytest.mark.parametrize(
    "name",
    [
        "ailsrs",
        "gail",
        # What these have of their own is in the tests of runs, below, and of GAIL.
        *(pytest.param(name, marks=pytest.mark.slow) for name in ("ars", "trpo", "bc")),
    ],
)
def test_training_goes_on(name: str, point_mass_expert: Demonstrations) -> None:
    """With three episodes of ten that diverge, and without a single one that does not."""

    @jax.jit
    def train(share: jax.Array) -> Any:
        trainer = learners(point_mass_expert)[name](ExplodingPointMass(share))
        return trainer.train(jax.random.key(0))

    state, metrics = train(0.3)
    require_finite(state)
    share = metrics["diverged"].sum() / metrics["episodes"].sum()
    # Environments that go on from batch to batch begin more episodes where these are short.
    assert 0.2 < share < (0.9 if name in ("gail", "trpo") else 0.4)
    weights = state.actor_critic.actor.log_std if name in ("gail", "trpo") else state.weights
    assert np.abs(weights).max() > 1e-3
    if name in ("ailsrs", "ars"):  # nothing of what led up to it, which is beyond 1000
        assert float(jnp.abs(state.statistics.mean).max()) < 2
        assert float(state.statistics.std.max()) < 3

    state, metrics = train(1.0)
    require_finite(state)
    np.testing.assert_array_equal(metrics["diverged"], metrics["episodes"])
    if name in ("ars", "ailsrs"):
        assert not state.weights.any()  # there was nothing to learn from


def test_counts_do_not_depend_on_the_number_of_devices() -> None:
    settings = ArsSettings(**SEARCH | {"num_directions": 48}, episode_length=EPISODE_LENGTH)
    results = [
        jax.jit(make_ars(Simulator(ExplodingPointMass(), mesh), settings).train)(jax.random.key(0))[
            1
        ]
        for mesh in (None, Mesh(np.array(jax.devices()[:4]), (AXIS,)))
    ]
    for name in ("env_steps", "episodes", "diverged"):
        np.testing.assert_array_equal(results[0][name], results[1][name])
    assert results[0]["episodes"].tolist() == [2 * 48 + settings.num_evaluation_episodes] * 4


def test_batches_hold_other_steps_instead() -> None:
    env = ExplodingPointMass()
    episodes = segments.begin(env, jax.random.key(0), 10, EPISODE_LENGTH)
    episodes, steps = segments.collect(
        env, some_policy(0.0, 0.1), episodes, jax.random.key(1), 40, EPISODE_LENGTH
    )
    copied, diverged = np.asarray(steps.copied), np.asarray(steps.diverged)
    assert 0 < diverged.sum() < copied.sum() <= 6 * diverged.sum()
    assert (diverged <= copied).all()
    useful = {row.tobytes() for row in np.asarray(steps.observations)[~copied]}
    assert all(row.tobytes() in useful for row in np.asarray(steps.observations)[copied])
    assert float(jnp.abs(steps.observations).max()) < 5.0
    assert np.asarray(steps.over)[copied].all()
    for leaf in jax.tree.leaves((steps, episodes)):
        assert np.isfinite(leaf).all()
    # What follows a diverged step is a new episode.
    after = np.asarray(episodes.time)
    assert (after < 40).any()


def test_a_run_on_a_model_that_explodes(tmp_path: Path) -> None:
    env = StiffSlider("mujoco", tmp_path)
    demonstrations = noise(2, 1, [20, 20], "StiffSlider")
    settings = SEARCH | ADVERSARY | {"episode_length": 20, "discriminator_batch_size": 50}
    run = ail.train(env, demonstrations, preset="paper", output=tmp_path / "run", **settings)
    with (tmp_path / "run" / "metrics.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["episodes"] for row in rows] == ["104"] * 4
    assert all(0.2 < int(row["diverged"]) / 104 < 0.4 for row in rows)
    assert all(math.isfinite(float(row["imitation_reward"])) for row in rows)
    assert np.isfinite(run.policies[0].weights).all()


def test_a_search_on_a_model_that_explodes_in_mjx(tmp_path: Path) -> None:
    settings = ArsSettings(**SEARCH, episode_length=20)
    trainer = make_ars(StiffSlider("mjx", tmp_path), settings)
    state, metrics = jax.jit(trainer.train)(jax.random.key(1))
    require_finite(state)
    share = metrics["diverged"] / metrics["episodes"]
    assert (share > 0.2).all()
    assert (share < 0.4).all()
    # The positions from which nothing diverges are those between the walls.
    assert float(state.statistics.std[0]) < 0.35
    assert np.abs(state.weights).max() > 0


def test_a_run_stops_where_most_diverges(tmp_path: Path) -> None:
    output, env = tmp_path / "run", ExplodingPointMass(share=0.7)
    arguments: dict[str, Any] = SEARCH | {"episode_length": EPISODE_LENGTH, "output": output}
    messages = []
    for resume in (False, True):
        with pytest.raises(ail.UserError, match=r"^stopped: \d+ of 108 episodes of iter") as caught:
            ail.train(env, algorithm="ars", resume=resume, **arguments)
        messages.append(str(caught.value))
        assert len((output / "metrics.csv").read_text().splitlines()) == 2
        assert (output / "checkpoints" / "0").is_dir()
        assert (output / "seed_0" / "policy.npz").is_file()
    assert messages[0] == messages[1]


def test_experts_and_evaluations_say_so() -> None:
    env = ExplodingPointMass()
    policy = linear_policy(np.zeros((1, 2)), "ExplodingPointMass")
    with pytest.raises(ail.UserError, match=r"episode \d+ of the expert diverged"):
        ail.demonstrate(policy, 20, env=env, episode_length=10)
    evaluation = ail.evaluate(policy, 50, env=env, episode_length=10)
    assert 5 < evaluation.num_diverged < 25
    assert f"({evaluation.num_diverged} of 50 diverged)" in str(evaluation)
    plain = ail.evaluate(policy, 50, env=PointMass(), episode_length=10)
    assert plain.num_diverged == 0
    stable = np.isfinite(evaluation.returns)
    np.testing.assert_allclose(evaluation.mean, plain.returns[stable].mean(), rtol=1e-5)
    assert "diverged" not in str(plain)
