import dataclasses
import functools
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ailsrs_jax.components.discriminator import Discriminator
from ailsrs_jax.data.demonstrations import Demonstrations
from ailsrs_jax.envs.registry import make_env
from ailsrs_jax.errors import UserError
from ailsrs_jax.trainers.ailsrs import Ailsrs, make_ailsrs
from ailsrs_jax.trainers.parts.ailsrs_settings import AilsrsSettings
from ailsrs_jax.trainers.parts.episodes import Episodes
from ailsrs_jax.trainers.parts.reference import distance_features
from tests.exploding import StiffSlider
from tests.point_mass import EPISODE_LENGTH, EXPERT_WEIGHTS, PointMass, noise

SMALL = AilsrsSettings(
    num_iterations=3,
    num_directions=4,
    num_top_directions=2,
    episode_length=EPISODE_LENGTH,
    discriminator_batch_size=32,
    memory_samples=64,
    memory_iterations=2,
    gradient_penalty=1.0,
    num_distance_samples=100,
)


@pytest.fixture
def trainer(point_mass: PointMass, point_mass_expert: Demonstrations) -> Ailsrs:
    return make_ailsrs(point_mass, point_mass_expert, SMALL)


def test_train_is_the_scan_of_update(trainer: Ailsrs) -> None:
    final, metrics = jax.jit(trainer.train)(jax.random.key(0))
    state = jax.jit(trainer.init)(jax.random.key(0))
    update = jax.jit(trainer.update)
    for iteration in range(SMALL.num_iterations):
        state, now = update(state)
        for name, value in now.items():
            np.testing.assert_allclose(metrics[name][iteration], value, rtol=1e-4, atol=1e-5)
    np.testing.assert_allclose(final.weights, state.weights, rtol=1e-4, atol=1e-6)
    assert int(final.iteration) == SMALL.num_iterations
    assert float(final.statistics.count) > 0
    assert update._cache_size() == 1  # it is not traced again


def test_seeds_under_vmap_equal_separate_runs(trainer: Ailsrs) -> None:
    seeds = jnp.array([0, 7])
    together, metrics = jax.jit(jax.vmap(lambda s: trainer.train(jax.random.key(s))))(seeds)
    for index, seed in enumerate(seeds):
        alone, alone_metrics = jax.jit(trainer.train)(jax.random.key(seed))
        np.testing.assert_allclose(together.weights[index], alone.weights, rtol=1e-4, atol=1e-6)
        for name, values in alone_metrics.items():
            np.testing.assert_allclose(metrics[name][index], values, rtol=1e-3, atol=1e-4)


@pytest.mark.slow
def test_settings_may_be_traced(
    point_mass: PointMass, point_mass_expert: Demonstrations, trainer: Ailsrs
) -> None:
    def final_weights(step_size: jax.Array) -> jax.Array:
        settings = dataclasses.replace(SMALL, step_size=step_size, final_step_size=step_size)
        return (
            make_ailsrs(point_mass, point_mass_expert, settings).train(jax.random.key(0))[0].weights
        )

    swept = jax.jit(jax.vmap(final_weights))(jnp.array([0.02, 0.2]))
    np.testing.assert_allclose(
        swept[0], jax.jit(trainer.train)(jax.random.key(0))[0].weights, rtol=1e-4, atol=1e-6
    )
    assert float(jnp.abs(swept[1]).sum()) > 2 * float(jnp.abs(swept[0]).sum())


def test_the_paper_starts_from_nothing(trainer: Ailsrs) -> None:
    state = trainer.init(jax.random.key(0))
    assert not state.weights.any()
    np.testing.assert_array_equal(state.statistics.mean, [0.0, 0.0])
    np.testing.assert_array_equal(state.statistics.std, [1.0, 1.0])


def test_behavior_cloning_start_is_the_expert_where_the_expert_is_linear(
    point_mass: PointMass, point_mass_expert: Demonstrations
) -> None:
    settings = dataclasses.replace(SMALL, behavior_cloning_start=True)
    trainer = make_ailsrs(point_mass, point_mass_expert, settings)
    state = trainer.init(jax.random.key(0))
    seen = point_mass_expert.observations[point_mass_expert.alive]
    np.testing.assert_allclose(state.statistics.mean, seen.mean(axis=0), atol=1e-5)
    weights, intercept = state.weights[:, :-1], state.weights[:, -1]
    np.testing.assert_allclose(weights / state.statistics.std, EXPERT_WEIGHTS, atol=0.1)
    assert not intercept.any()


@pytest.mark.parametrize(
    ("sees", "after_end"),
    [("state_action", 1.0), ("state_action", 0.75), ("state", 0.0), ("state_next_state", 0.75)],
)
def test_reward_of_a_rollout_in_closed_form(
    after_end: float, sees: str, point_mass: PointMass, point_mass_expert: Demonstrations
) -> None:
    """With any parameters: softplus of the logits, over live steps only, in slices or not."""
    settings = dataclasses.replace(
        SMALL, reward_after_end=after_end, discriminator_sees=sees, episode_length=120
    )
    trainer = make_ailsrs(point_mass, point_mass_expert, settings)
    adversary = trainer.init(jax.random.key(1)).adversary
    lengths = np.array([2, 49, 50, 51, 120, 1])
    observations = np.random.default_rng(0).normal(size=(6, 120, 2)).astype(np.float32)
    actions = np.random.default_rng(1).normal(size=(6, 120, 1)).astype(np.float32)
    episodes = Episodes(
        *map(jnp.asarray, (observations, actions, actions[..., 0], lengths)),
        diverged=jnp.arange(6) == 5,
        final_observations=jnp.zeros((6, 2)),
        slot_steps=lengths.sum(),
    )
    returns = trainer.judge(adversary, episodes).ravel()
    assert np.isnan(returns[5])
    logit = functools.partial(Discriminator().apply, adversary.parameters)
    mean, std = trainer.reference.statistics.mean, trainer.reference.statistics.std
    for index, length in enumerate(lengths[:5]):
        states = (observations[index, :length] - mean) / std
        inputs = {
            "state_action": jnp.concatenate([states, actions[index, :length]], axis=1),
            "state": states,
            "state_next_state": jnp.concatenate([states[:-1], states[1:]], axis=1),
        }[sees]
        rewards = -np.log1p(-jax.nn.sigmoid(logit(inputs)))
        padded = np.full(120, after_end * rewards.mean())
        padded[:length] = rewards.mean()
        expected = padded.mean()
        np.testing.assert_allclose(returns[index], expected, rtol=1e-4)


def test_the_discriminator_learns_to_tell_them_apart(trainer: Ailsrs) -> None:
    settings = dataclasses.replace(SMALL, discriminator_steps=300, gradient_penalty=0.0)
    trainer = dataclasses.replace(trainer, settings=settings)
    state = trainer.init(jax.random.key(0))
    _, metrics = jax.jit(trainer.update)(state)
    assert float(metrics["expert_score"]) > float(metrics["policy_score"]) + 0.1
    assert float(metrics["discriminator_loss"]) < 0.25  # that of a coin


def test_step_size_decays_linearly(trainer: Ailsrs) -> None:
    settings = dataclasses.replace(SMALL, num_iterations=11, step_size=0.3, final_step_size=0.1)
    trainer = dataclasses.replace(trainer, settings=settings)
    state = trainer.init(jax.random.key(0))
    deltas = jnp.ones((4, *state.weights.shape))
    returns = jnp.array([[1.0, 2.0, 3.0, 4.0], [0.0, 0.0, 0.0, 0.0]])

    def moved(num_updates: int) -> float:
        after = trainer.tell(state.replace(num_updates=jnp.array(num_updates)), deltas, returns)
        return float((after - state.weights)[0, 0])

    # With the twelfth a new cycle begins.
    sizes = np.array([moved(num_updates) for num_updates in (0, 5, 10, 11)])
    np.testing.assert_allclose(sizes / sizes[0], [1, 2 / 3, 1 / 3, 1], rtol=1e-5)


def test_distance_sees_the_length_of_episodes() -> None:
    inputs = jax.random.normal(jax.random.key(0), (6, EPISODE_LENGTH, 3))
    lengths = jnp.full(6, 20)
    features = distance_features(jax.random.key(1), inputs, lengths, EPISODE_LENGTH, 100)
    absorbed = features[:, -1] > 0
    np.testing.assert_allclose(absorbed.mean(), 1 - 20 / EPISODE_LENGTH, atol=0.15)
    assert not features[absorbed, :-1].any()
    assert features[~absorbed, :-1].any(axis=1).all()


def test_an_expert_is_kept_and_a_worse_policy_is_not(trainer: Ailsrs) -> None:
    trainer = dataclasses.replace(
        trainer,
        settings=dataclasses.replace(SMALL, standardize_with="expert", num_evaluation_episodes=20),
    )
    update, state = jax.jit(trainer.update), trainer.init(jax.random.key(0))
    expert_weights = EXPERT_WEIGHTS * state.statistics.std
    distances = []
    for weights in (0.0 * expert_weights, expert_weights, -expert_weights):
        state, metrics = update(state.replace(mean_weights=jnp.pad(weights, [(0, 0), (0, 1)])))
        distances.append(float(metrics["expert_distance"]))
    assert state.statistics.count == trainer.reference.statistics.count  # they stay the expert's
    assert min(distances) == distances[1] < 0.5 * min(distances[0], distances[2])
    np.testing.assert_array_equal(state.kept.policy.weights, expert_weights)


def test_learns_the_point_mass_from_nothing(
    point_mass: PointMass, point_mass_expert: Demonstrations
) -> None:
    settings = dataclasses.replace(
        SMALL,
        num_iterations=150,
        num_directions=16,
        num_top_directions=8,
        step_size=0.1,
        final_step_size=0.02,
        noise_std=0.1,
        discriminator_learning_rate=1e-3,
        discriminator_batch_size=256,
        memory_samples=1000,
        memory_iterations=5,
        num_distance_samples=500,
    )
    trainer = make_ailsrs(point_mass, point_mass_expert, settings)
    state, metrics = jax.jit(trainer.train)(jax.random.key(0))
    expert_return = point_mass_expert.returns.mean()
    kept_return = float(metrics["evaluation_return"][int(state.kept.iteration)])
    assert float(metrics["evaluation_return"][0]) < 2 * expert_return  # far below: it is negative
    assert kept_return > 1.3 * expert_return


def swimmer_trainer(physics: str, settings: AilsrsSettings) -> Ailsrs:
    demonstrations = noise(8, 2, [50, 20], "Swimmer-v5")
    return make_ailsrs(make_env("swimmer", physics), demonstrations, settings)


def abstract_state(trainer: Ailsrs) -> Any:
    """The training state of two seeds, as shapes."""
    seeds = jax.ShapeDtypeStruct((2,), jnp.int32)
    return jax.eval_shape(
        lambda seeds: jax.vmap(trainer.init)(jax.vmap(jax.random.key)(seeds)), seeds
    )


@pytest.mark.parametrize("platform", ["cuda", pytest.param("tpu", marks=pytest.mark.slow)])
def test_with_mjx_it_is_one_program_for_an_accelerator(platform: str, tmp_path: Path) -> None:
    settings = AilsrsSettings(num_directions=32, num_top_directions=16, gradient_penalty=1.0)
    trainer = make_ailsrs(StiffSlider("mjx", tmp_path), noise(2, 1, [50, 20], "Slider"), settings)
    update = jax.jit(jax.vmap(trainer.update))
    exported = jax.export.export(update, platforms=[platform])(abstract_state(trainer))
    program = exported.mlir_module()
    assert len(program) > 100_000
    assert "callback" not in program


def test_with_the_c_engine_it_calls_the_host() -> None:
    """The word that the test above looks for is there when there is a callback."""
    trainer = swimmer_trainer("mujoco", SMALL)
    program = jax.jit(jax.vmap(trainer.update)).lower(abstract_state(trainer)).as_text()
    assert "callback" in program


def test_a_step_on_mjx_is_the_step_on_the_c_engine() -> None:
    settings = dataclasses.replace(SMALL, episode_length=20)
    states = []
    for physics in ("mjx", "mujoco"):
        trainer = swimmer_trainer(physics, settings)
        state, metrics = jax.jit(trainer.search)(trainer.init(jax.random.key(0)), jax.random.key(1))
        assert all(bool(jnp.isfinite(value)) for value in metrics.values())
        states.append(state)
    ours, reference = states
    assert float(jnp.abs(ours.weights).max()) > 0
    np.testing.assert_allclose(ours.statistics.mean, reference.statistics.mean, atol=1e-3)
    np.testing.assert_allclose(ours.weights, reference.weights, atol=2e-3)


def test_imitation_from_observation(
    point_mass: PointMass, point_mass_expert: Demonstrations
) -> None:
    """Without actions the discriminator sees states; what would need actions is refused."""
    states_alone = point_mass_expert.replace(actions=None)
    for sees in ("state", "state_next_state"):
        settings = dataclasses.replace(SMALL, discriminator_sees=sees)
        trainer = make_ailsrs(point_mass, states_alone, settings)
        _, metrics = jax.jit(trainer.update)(trainer.init(jax.random.key(0)))
        assert all(bool(jnp.isfinite(value)) for value in metrics.values())
    with pytest.raises(UserError, match="no actions, which discriminator_sees=state_action needs"):
        make_ailsrs(point_mass, states_alone, SMALL)
    cloned = dataclasses.replace(SMALL, discriminator_sees="state", behavior_cloning_start=True)
    with pytest.raises(UserError, match="no actions, which behavior_cloning_start needs"):
        make_ailsrs(point_mass, states_alone, cloned)
    pairs = dataclasses.replace(SMALL, discriminator_sees="state_next_state")
    with pytest.raises(UserError, match="subsampled: discriminator_sees=state_next_state needs"):
        make_ailsrs(point_mass, point_mass_expert.subsample(2), pairs)
