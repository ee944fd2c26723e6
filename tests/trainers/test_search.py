"""The parts of AILSRS that its paper does not have."""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import ailsrs_jax as ail
from ailsrs_jax.data.demonstrations import Demonstrations
from ailsrs_jax.data.policies import SavedMlpPolicy
from ailsrs_jax.errors import UserError
from ailsrs_jax.runs.storage.policies import saved_policy
from ailsrs_jax.trainers.ailsrs import Ailsrs, make_ailsrs
from ailsrs_jax.trainers.gail import GailSettings, make_gail
from ailsrs_jax.trainers.parts import policy_space
from ailsrs_jax.trainers.parts.ailsrs_settings import AilsrsSettings
from tests.point_mass import EPISODE_LENGTH, EXPERT_WEIGHTS, PointMass

SMALL = AilsrsSettings(
    num_iterations=2,
    num_directions=4,
    num_top_directions=2,
    episode_length=EPISODE_LENGTH,
    discriminator_batch_size=32,
    memory_samples=64,
    num_distance_samples=100,
    standardize_with="expert",
)


@pytest.fixture
def changed(point_mass: PointMass, point_mass_expert: Demonstrations) -> Any:
    """Makes a trainer with changed settings."""

    def make(**changes: Any) -> Ailsrs:
        settings = dataclasses.replace(SMALL, **changes)
        return make_ailsrs(point_mass, point_mass_expert, settings)

    return make


def test_the_clone_has_an_intercept(
    point_mass: PointMass, point_mass_expert: Demonstrations
) -> None:
    shifted = point_mass_expert.replace(actions=point_mass_expert.actions + 0.3)
    settings = dataclasses.replace(SMALL, behavior_cloning_start=True, intercept=True)
    state = make_ailsrs(point_mass, shifted, settings).init(jax.random.key(0))
    weights = state.weights[:, :-1] / state.statistics.std
    intercept = state.weights[:, -1] - weights @ state.statistics.mean
    np.testing.assert_allclose(weights, EXPERT_WEIGHTS, atol=0.1)
    np.testing.assert_allclose(intercept, 0.3, atol=0.05)


def test_entries_that_are_not_there_are_refused_at_once(changed: Any) -> None:
    with pytest.raises(UserError, match="entries 0:9 are not among the 2 of an observation"):
        changed(policy_entries="0:9")


def test_only_entries_that_are_seen_are_searched(changed: Any) -> None:
    trainer = changed(policy_entries="1:2", intercept=True)
    deltas = trainer.ask(jax.random.key(0))
    assert not deltas[..., 0].any()
    assert deltas[..., 1:].all()
    assert not changed().ask(jax.random.key(0))[..., -1].any()
    with pytest.raises(UserError, match="entries 1:3 are not among the 2 of an observation"):
        changed(discriminator_entries="1:3")


@pytest.fixture
def cloned_in_short(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(policy_space, "CLONING_STEPS", 1000)


@pytest.mark.usefixtures("cloned_in_short")
def test_of_a_cloned_network_the_last_layer_is_searched(
    changed: Any, point_mass_expert: Demonstrations
) -> None:
    trainer = changed(policy="mlp", behavior_cloning_start=True, intercept=True)
    state = trainer.init(jax.random.key(0))
    seen = point_mass_expert.observations[point_mass_expert.alive]
    cloned = np.asarray(jax.vmap(state.kept.policy)(seen))
    np.testing.assert_allclose(cloned, point_mass_expert.actions[point_mass_expert.alive], atol=0.1)

    after, metrics = jax.jit(trainer.update)(state)
    assert np.isfinite(metrics["expert_distance"])
    jax.tree.map(np.testing.assert_array_equal, after.hidden, state.hidden)
    assert (after.weights != state.weights).all()
    kept = after.kept.policy
    np.testing.assert_array_equal(kept.weights[0], state.hidden[0][0])
    np.testing.assert_array_equal(trainer.space.weights(kept)[:, -1], kept.biases[-1])

    saved = saved_policy(kept, "PointMass-v0")
    assert isinstance(saved, SavedMlpPolicy)
    assert not saved.is_stochastic
    np.testing.assert_allclose(saved(seen), jax.vmap(kept)(seen), atol=1e-5)


@pytest.mark.usefixtures("cloned_in_short")
def test_a_network_sees_its_entries(changed: Any) -> None:
    trainer = changed(policy="mlp", behavior_cloning_start=True, policy_entries="1:2")
    policy = trainer.init(jax.random.key(0)).kept.policy
    one, other = policy(jnp.array([0.0, 1.0])), policy(jnp.array([5.0, 1.0]))
    np.testing.assert_array_equal(one, other)
    assert policy(jnp.array([0.0, -1.0])) != one


def test_a_network_needs_a_clone(changed: Any) -> None:
    with pytest.raises(UserError, match="policy=mlp needs behavior_cloning_start=true"):
        changed(policy="mlp")


def test_the_discriminator_sees_its_entries(changed: Any) -> None:
    one, both = changed(discriminator_entries="1:2"), changed()
    assert (one.adversary.input_size, both.adversary.input_size) == (2, 3)
    observations = jax.random.normal(jax.random.key(0), (5, 2))
    actions = jnp.zeros((5, 1))
    seen, all_seen = (
        trainer.adversary.inputs(observations, actions, observations) for trainer in (one, both)
    )
    np.testing.assert_array_equal(seen, all_seen[:, 1:])


def test_gail_has_the_discriminators_settings_too(
    point_mass: PointMass, point_mass_expert: Demonstrations
) -> None:
    settings = GailSettings(
        num_iterations=3,
        updates_per_iteration=1,
        policy_steps=1,
        num_envs=2,
        batch_size=20,
        episode_length=EPISODE_LENGTH,
        discriminator_entries="1:2",
        gradient_penalty=1.0,
    )

    @jax.jit
    def trained(decay: jax.Array) -> Any:
        changed = dataclasses.replace(settings, gradient_penalty_decay=decay)
        trainer = make_gail(point_mass, point_mass_expert, changed)
        assert trainer.adversary.input_size == 2
        last = trainer.init(jax.random.key(0)).replace(iteration=jnp.array(2))
        return trainer.update(last)[0].adversary.parameters

    states = trained(1.0), trained(0.01)
    differences = jax.tree.map(lambda x, y: float(jnp.abs(x - y).max()), *states)
    assert max(jax.tree.leaves(differences)) > 0


def test_starts_are_common_to_all_policies_of_an_update(changed: Any) -> None:
    def first_observations(common: bool) -> np.ndarray:
        trainer = changed(common_starts=common, num_starts=2, search_length=3)
        state = trainer.init(jax.random.key(0))
        episodes = trainer.simulate(state, trainer.ask(jax.random.key(1)), jax.random.key(2))
        assert episodes.observations.shape == (16, 3, 2)
        return np.asarray(episodes.observations[:, 0]).reshape(8, 2, 2)

    apart, common = first_observations(False), first_observations(True)
    assert len(np.unique(apart[..., 0])) == 16
    assert len(np.unique(common[..., 0])) == 2
    np.testing.assert_array_equal(common, np.tile(common[:1], (8, 1, 1)))


def test_the_share_of_demonstrated_starts() -> None:
    demonstrations = ail.demonstrate(ail.load_expert("swimmer"), 2, episode_length=30)
    recorded = np.asarray(demonstrations.observations).reshape(-1, 8)
    env = ail.make_env("swimmer", "mujoco")
    for share, number in ((0.0, 0), (0.5, 4), (1.0, 8)):
        settings = dataclasses.replace(SMALL, demonstrated_starts=share, episode_length=30)
        trainer = make_ailsrs(env, demonstrations, settings)
        state = trainer.init(jax.random.key(0))
        deltas = trainer.ask(jax.random.key(1))
        first = np.asarray(trainer.simulate(state, deltas, jax.random.key(2)).observations[:, 0])
        nearest = np.abs(first[:, None] - recorded).max(axis=-1).min(axis=1)
        assert (nearest < 1e-3).sum() == number


def test_a_return_is_the_mean_over_the_starts(changed: Any) -> None:
    trainer = changed(num_starts=2)
    state = trainer.init(jax.random.key(0))
    episodes = trainer.simulate(state, trainer.ask(jax.random.key(1)), jax.random.key(2))
    one_each = dataclasses.replace(
        trainer, settings=dataclasses.replace(trainer.settings, num_starts=1)
    )
    np.testing.assert_allclose(
        trainer.judge(state.adversary, episodes),
        one_each.judge(state.adversary, episodes).reshape(2, 4, 2).mean(axis=-1),
        rtol=1e-6,
    )


def test_the_mean_of_the_iterates(changed: Any) -> None:
    trainer = changed(averaging=0.75, num_iterations=5, updates_per_iteration=2)
    update, state = jax.jit(trainer.search), trainer.init(jax.random.key(0))
    mean = np.zeros((1, 3))
    for key in jax.random.split(jax.random.key(1), 3):
        state, _ = update(state, key)
        mean = 0.75 * mean + 0.25 * np.asarray(state.weights)
        np.testing.assert_allclose(state.mean_weights, mean, rtol=1e-5, atol=1e-7)
    new_state, _ = jax.jit(trainer.update)(state)
    kept = new_state.kept.policy
    np.testing.assert_allclose(kept.weights, state.mean_weights[:, :-1], rtol=1e-6)


def test_an_iteration_is_an_evaluation_and_several_updates(changed: Any) -> None:
    trainer = changed(updates_per_iteration=3, num_evaluation_episodes=5, search_length=7)
    state, metrics = jax.jit(trainer.update)(trainer.init(jax.random.key(0)))
    assert (int(state.iteration), int(state.num_updates)) == (1, 3)
    assert int(metrics["episodes"]) == 3 * 8 + 5
    assert int(metrics["env_steps"]) <= 3 * 8 * 7 + 5 * EPISODE_LENGTH
    assert int(state.memory.lengths.max()) <= 7


def test_noise_and_penalty_fall(changed: Any) -> None:
    trainer = changed(
        num_iterations=3, noise_std=0.2, noise_decay=0.25, search_length=1, common_starts=True
    )
    deltas = jnp.ones((4, 1, 3))
    spreads = []
    for num_updates in (0, 1, 2, 3):
        state = trainer.init(jax.random.key(0)).replace(num_updates=jnp.array(num_updates))
        actions = trainer.simulate(state, deltas, jax.random.key(1)).actions[:, 0, 0]
        spreads.append(float(actions[0] - actions[-1]))
    np.testing.assert_allclose(np.divide(spreads, spreads[0]), [1, 0.5, 0.25, 1], rtol=1e-3)


def test_the_discriminator_is_trained_longer_before_the_first_step(changed: Any) -> None:
    trainer = changed(warmup_rounds=50, discriminator_learning_rate=1e-3)
    state, first = jax.jit(trainer.update)(trainer.init(jax.random.key(0)))
    assert int(state.adversary.optimizer[0].count) == 50 * SMALL.discriminator_steps
    state, _ = jax.jit(trainer.update)(state)
    assert int(state.adversary.optimizer[0].count) == 51 * SMALL.discriminator_steps
    assert float(first["expert_score"]) > float(first["policy_score"]) + 0.1


def test_the_penalty_is_controlled_by_the_gap_of_the_scores(changed: Any) -> None:

    @jax.jit
    def updated(gap: jax.Array) -> Any:
        trainer = changed(
            score_gap=gap, gradient_penalty=10.0, warmup_rounds=20, discriminator_steps=10
        )
        state = trainer.init(jax.random.key(0))
        lowered = state.adversary.replace(penalty=jnp.array(1.0))
        return trainer.update(state.replace(adversary=lowered))

    for gap, rises in ((0.9, False), (1e-6, True)):
        state, metrics = updated(gap)
        assert float(metrics["expert_score"]) > float(metrics["policy_score"])
        assert (float(state.adversary.penalty) > 1.0) == rises
        assert 0.29 < float(state.adversary.penalty) <= 10.0


def test_scores_that_are_not_finite_do_not_move_the_penalty(changed: Any) -> None:
    trainer = changed(score_gap=0.1, gradient_penalty=10.0, discriminator_learning_rate=1e38)
    state, metrics = jax.jit(trainer.update)(trainer.init(jax.random.key(0)))
    assert not np.isfinite(metrics["expert_score"])
    assert float(state.adversary.penalty) == 10.0


def test_a_controlled_penalty_decays_too(changed: Any) -> None:
    trainer = changed(
        score_gap=1e-6,  # so it would rise
        gradient_penalty=10.0,
        gradient_penalty_decay=0.3,
        num_iterations=3,
    )
    state = trainer.init(jax.random.key(0)).replace(num_updates=jnp.array(1))  # half of them
    state, _ = jax.jit(trainer.update)(state)
    np.testing.assert_allclose(state.adversary.penalty, 10 * 0.3**0.5, rtol=1e-4)


def test_the_energy_distance_is_a_share_of_the_return(changed: Any) -> None:
    trainer = changed(num_starts=2, behavior_cloning_start=True)
    state = trainer.init(jax.random.key(0))
    far = jnp.zeros((4, 1, 3)).at[0, 0].set(jnp.array([30.0, 10.0, 0.0]))
    episodes = trainer.simulate(state, far, jax.random.key(2))
    judged = trainer.judge(state.adversary, episodes)

    def returns(share: float) -> np.ndarray:
        settings = dataclasses.replace(trainer.settings, energy_share=share)
        sharing = dataclasses.replace(trainer, settings=settings)
        return np.asarray(sharing.compare(judged, episodes, jax.random.key(3)))

    reward, mixed, distance = (returns(share) for share in (0.0, 0.25, 1.0))
    assert np.std(distance) == pytest.approx(1.0, rel=1e-4)
    np.testing.assert_allclose(mixed, 0.75 * reward / np.std(reward) + 0.25 * distance, rtol=1e-3)
    assert distance.argmin() in (0, 4)  # one of the two policies that are far from the clone


def test_the_search_goes_on_from_the_kept_policy(changed: Any) -> None:
    for beyond, returns in ((0.0, False), (1.5, True), (1e6, False)):
        trainer = changed(
            recentre_beyond=beyond,
            step_size=1e-9,
            final_step_size=0.0,
            behavior_cloning_start=True,
        )
        state, _ = jax.jit(trainer.update)(trainer.init(jax.random.key(0)))
        kept = np.asarray(state.kept.policy.weights)
        astray = state.weights.at[0, 0].set(-30.0)
        state, metrics = jax.jit(trainer.update)(state.replace(weights=astray, mean_weights=astray))
        assert float(metrics["expert_distance"]) > 1.5 * -float(state.kept.score)
        assert (np.abs(np.asarray(state.weights)[:, :-1] - kept).max() < 1e-6) == returns
    with pytest.raises(UserError, match="recentre_beyond needs standardize_with=expert"):
        changed(recentre_beyond=2.0, standardize_with="running")


def test_training_ends_after_a_cycle_that_came_close(changed: Any) -> None:
    trainer = changed(num_iterations=4, cycle_iterations=2, finish_distance=0.2)
    update, start = jax.jit(trainer.update), trainer.init(jax.random.key(0))
    for close in (True, False):
        score = jnp.full((), -0.1 if close else -0.4)
        state, kept = start, start.kept.replace(score=score, highest=jnp.zeros(()))
        finished, done = [], []
        for _ in range(4):
            state, _ = update(state.replace(kept=kept))
            finished.append(bool(state.finished))
            done.append(float(trainer.done(state)))
        assert finished == [False, close, False, close]
        assert done == [1.0, 0.0, 1.0, 0.0]
