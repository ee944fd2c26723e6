"""The actions of demonstrations that hold states alone."""

import logging
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax

from ailsrs_jax.components.policy import repeated
from ailsrs_jax.data.demonstrations import Demonstrations
from ailsrs_jax.envs import Env
from ailsrs_jax.envs.interface import action_range
from ailsrs_jax.errors import UserError
from ailsrs_jax.host_calls import host_errors
from ailsrs_jax.runs.policies import still_policy
from ailsrs_jax.trainers.parts.rollout import simulate

logger = logging.getLogger(__name__)

Step = Callable[[jax.Array, jax.Array], jax.Array]  # (B, n) and (B, p) to (B, n)
NUM_ROUNDS = 6  # of the Levenberg-Marquardt method
PROBE = 0.01  # of half the range of an action: the finite difference
CHUNK = 500  # transitions at a time, which bounds the memory
UNEXPLAINED = 0.1  # the largest share of a median transition that the inferred action leaves


def infer_actions(demonstrations: Demonstrations, env: Env) -> Demonstrations:
    """Return ``demonstrations`` with the actions that lead from each state to the next.

    The action of a transition minimises ‖(f(s, a) − s') / σ‖², where f is a step of ``env`` from
    the demonstrated state s, s' is the next one, and σ the standard deviation of all changes. So a
    simulator that can be put into a state takes the place of the inverse model that behaviour
    cloning from observation learns (Torabi, Warnell and Stone, 2018). The last action of an episode
    repeats the one before it.

    Args:
        demonstrations: with every step of each episode.
        env: has ``state_at``. One transition takes ``6 (p + 1)`` environment steps.

    Raises:
        UserError: no episode has two steps.
    """
    observations = np.asarray(demonstrations.observations)
    alive = np.asarray(demonstrations.alive)
    episode, time = np.nonzero(alive[:, :-1] & alive[:, 1:])
    states, following = observations[episode, time], observations[episode, time + 1]
    if not len(states):
        raise UserError("the demonstrations hold no state with a next one, so no action is known")
    with host_errors():
        found, unexplained = map(np.asarray, _infer(env)(states, following))
    if np.median(unexplained) > UNEXPLAINED:
        logger.warning(
            "no action of the environment leads from a demonstrated state to the next: the best "
            "leave %.0f %% of what a step changes; these are states of another environment, or "
            "with noise",
            100 * np.median(unexplained),
        )
    actions = np.zeros((*alive.shape, found.shape[-1]), np.float32)
    actions[episode, time] = found
    last = np.asarray(demonstrations.lengths) - 1
    rows = np.arange(len(last))
    actions[rows, last] = actions[rows, np.maximum(last - 1, 0)]
    return demonstrations.replace(actions=actions)


def one_step(env: Env) -> Step:
    """Return a function that steps ``env`` once from observed states, with given actions."""

    def step(observations: jax.Array, actions: jax.Array) -> jax.Array:
        starts = jax.vmap(env.state_at)(observations)
        policies = repeated(still_policy(env), len(observations))
        return simulate(env, policies, starts, 1, noise=actions[:, None]).final_observations

    return step


def _infer(env: Env) -> Callable[[np.ndarray, np.ndarray], tuple[jax.Array, jax.Array]]:
    """Return a function of states and next states ``(M, n)``.

    It returns the actions ``(M, p)``, and ``(M,)`` the share of what a step changes that they leave
    unexplained.
    """
    step, (low, high), p = one_step(env), action_range(env), env.action_size

    @jax.jit
    def infer(states: jax.Array, following: jax.Array) -> tuple[jax.Array, jax.Array]:
        spread = jnp.std(following - states, axis=0)
        scale = jnp.where(spread > 1e-6, spread, jnp.inf)

        def of_transition(transition: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
            state, target = transition

            def errors(actions: jax.Array) -> jax.Array:
                """Return ``(k, n)`` for ``actions (k, p)`` in units of half their range."""
                actions = (low + high) / 2.0 + actions * (high - low) / 2.0
                return (target - step(repeated(state, len(actions)), actions)) / scale

            def improve(carry: Any, _: None) -> tuple[Any, None]:
                (best, error, jacobian), damping, proposed = carry
                probe = jnp.where(proposed > 0.0, -PROBE, PROBE)  # within the range
                found = errors(jnp.vstack([proposed, proposed + jnp.diag(probe)]))
                slopes = (found[0] - found[1:]).T / probe
                better = jnp.sum(found[0] ** 2) < jnp.sum(error**2)
                best, error, jacobian = optax.tree.where(
                    better, (proposed, found[0], slopes), (best, error, jacobian)
                )
                damping = damping * jnp.where(better, 0.2, 10.0)
                gram = jacobian.T @ jacobian
                damped = gram + (damping * jnp.trace(gram) / p + 1e-9) * jnp.eye(p)
                proposed = jnp.clip(best + jnp.linalg.solve(damped, jacobian.T @ error), -1.0, 1.0)
                return ((best, error, jacobian), damping, proposed), None

            n, still = len(state), jnp.zeros(p)
            unknown = still, jnp.full(n, jnp.inf), jnp.zeros((n, p))
            start = unknown, jnp.asarray(0.05), still
            (best, error, _), *_ = jax.lax.scan(improve, start, None, length=NUM_ROUNDS)[0]
            unexplained = jnp.sum(error**2) / jnp.maximum(jnp.sum(spread > 1e-6), 1)
            return (low + high) / 2.0 + best * (high - low) / 2.0, unexplained

        found: tuple[jax.Array, jax.Array]
        found = jax.lax.map(of_transition, (states, following), batch_size=CHUNK)
        return found

    return infer
