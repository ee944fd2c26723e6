import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ailsrs_jax.components import discriminator as adversary


def logit(score: float | np.ndarray) -> jax.Array:
    return jnp.log(jnp.asarray(score)) - jnp.log1p(-jnp.asarray(score))


def test_labels_expert_is_one_and_policy_is_zero() -> None:
    expert_side = adversary.least_squares_loss(jnp.full(3, -40.0), jnp.full(3, 40.0))
    other_side = adversary.least_squares_loss(jnp.full(3, 40.0), jnp.full(3, -40.0))
    np.testing.assert_allclose(expert_side, 0.0, atol=1e-7)
    np.testing.assert_allclose(other_side, 1.0)


def test_loss_is_that_of_each_pair() -> None:
    policy, expert = logit(np.array([0.5, 0.2])), logit(np.array([0.9, 0.3]))
    expected = [0.5 * 0.25 + 0.5 * 0.01, 0.5 * 0.04 + 0.5 * 0.49]
    np.testing.assert_allclose(adversary.least_squares_loss(policy, expert), expected, rtol=1e-5)
    crossed = -np.log([0.9, 0.3]) - np.log1p(-np.array([0.5, 0.2]))
    np.testing.assert_allclose(adversary.cross_entropy_loss(policy, expert), crossed, rtol=1e-5)


@pytest.mark.parametrize("score", [1e-4, 0.3, 0.5, 0.999])
def test_reward_is_minus_log_of_one_minus_score(score: float) -> None:
    reward = adversary.gail_reward(logit(score))
    np.testing.assert_allclose(reward, -np.log(1 - score), rtol=1e-3)


def test_reward_at_the_labels() -> None:
    rewards = adversary.gail_reward(jnp.array([-200.0, 0.0, 200.0]))
    np.testing.assert_allclose(rewards, [0.0, np.log(2), 200.0], atol=1e-6)


def test_reward_is_finite_and_expert_like_is_high() -> None:
    rewards = adversary.gail_reward(jnp.linspace(-1e4, 1e4, 101))
    assert bool(jnp.isfinite(rewards).all())
    assert bool((jnp.diff(rewards) >= 0).all())


@pytest.mark.parametrize("score", [1e-4, 0.3, 0.5, 0.999])
def test_other_rewards_and_the_entropy_in_closed_form(score: float) -> None:
    logits, other = logit(score), 1 - score
    airl = np.log(score) - np.log(other)
    np.testing.assert_allclose(adversary.airl_reward(logits), airl, rtol=1e-4, atol=1e-6)
    np.testing.assert_allclose(adversary.amp_reward(logits), 1 - other**2, rtol=1e-3)
    expected = -score * np.log(score) - other * np.log(other)
    np.testing.assert_allclose(adversary.entropy(logits), expected, rtol=1e-3)


def test_gradient_penalty_of_a_known_slope() -> None:
    slope = jnp.array([3.0, -4.0])
    near_zero = jnp.zeros((10, 2))
    # At logit 0 the sigmoid's slope is 1/4, so ∇D = slope / 4 and ‖∇D‖² = 25 / 16.
    penalty = adversary.gradient_penalty(
        lambda x: x @ slope, near_zero, near_zero, jax.random.key(0)
    )
    np.testing.assert_allclose(penalty, 25 / 16, rtol=1e-6)


def test_gradient_penalty_is_between_the_samples() -> None:
    def logits(x: jax.Array) -> jax.Array:
        return jnp.where(jnp.abs(x[0]) <= 1.0, 0.0, 1e3) * x[0]  # steep outside [−1, 1] only

    penalty = adversary.gradient_penalty(
        logits, -jnp.ones((50, 1)), jnp.ones((50, 1)), jax.random.key(0)
    )
    assert penalty.shape == (50,)
    assert not penalty.any()


def test_network_has_the_papers_shape() -> None:
    parameters = adversary.Discriminator().init(jax.random.key(0), jnp.zeros(14))
    shapes = jax.tree.map(jnp.shape, parameters["params"])
    assert shapes["Dense_0"]["kernel"] == (14, 100)
    assert shapes["Dense_1"]["kernel"] == (100, 100)
    assert shapes["Dense_2"]["kernel"] == (100, 1)
    assert adversary.Discriminator().apply(parameters, jnp.zeros((3, 5, 14))).shape == (3, 5)
