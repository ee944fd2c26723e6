import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ailsrs_jax.components.policy import LinearPolicy, keep


def some_policy(value: float = 1.0) -> LinearPolicy:
    return LinearPolicy(
        weights=jnp.full((1, 2), value),
        mean=jnp.array([1.0, 2.0]),
        std=jnp.array([0.5, 4.0]),
        action_low=jnp.array([-2.0]),
        action_high=jnp.array([3.0]),
    )


def test_action_by_hand_and_clipped() -> None:
    policy = some_policy()
    np.testing.assert_allclose(policy(jnp.array([1.5, 6.0])), [2.0])  # 1·1 + 1·1
    np.testing.assert_allclose(policy(jnp.array([9.0, 6.0])), [3.0])
    np.testing.assert_allclose(policy(jnp.array([-9.0, 6.0])), [-2.0])


def test_a_batch_of_policies_shares_statistics() -> None:
    batch = some_policy().with_weights(jnp.array([[[1.0, 0.0]], [[0.0, 1.0]]]))
    actions = jax.vmap(LinearPolicy.__call__, (0, None))(batch, jnp.array([2.0, 4.0]))
    np.testing.assert_allclose(actions, [[2.0], [0.5]])


def test_the_better_policy_is_kept() -> None:
    kept = keep(some_policy(0.0))
    for iteration, score in enumerate([-5.0, -1.0, jnp.nan, -3.0]):
        kept = kept.offer(some_policy(float(iteration)), jnp.asarray(score), jnp.array(iteration))
    assert int(kept.iteration) == 1
    assert float(kept.score) == -1.0
    np.testing.assert_array_equal(kept.policy.weights, jnp.ones((1, 2)))
    np.testing.assert_array_equal(kept.offered.weights, 3.0 * jnp.ones((1, 2)))


def test_the_latest_of_nearly_the_smallest_distance_is_kept() -> None:
    distances = [1.2, 1.0, 1.2, 1.3, 1.2, 2.0, 0.9, 1.1, 1.2]
    kept, found = keep(some_policy()), []
    for iteration, distance in enumerate(distances):
        kept = kept.offer(some_policy(), jnp.asarray(-distance), jnp.array(iteration), within=1.25)
        found.append(int(kept.iteration))
    assert found == [0, 1, 2, 2, 4, 4, 6, 7, 7]  # 1.3 and 2 are not within 1.25, nor is 1.2 of 0.9
    assert float(kept.score) == pytest.approx(-1.1)
