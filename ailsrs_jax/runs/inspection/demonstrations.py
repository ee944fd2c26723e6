"""Describe demonstrations before anything is trained on them."""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ailsrs_jax.components.linear_regression import affine_regression, ridge_regression
from ailsrs_jax.data.demonstrations import Demonstrations
from ailsrs_jax.envs import Env
from ailsrs_jax.envs.interface import action_range, starts_at_observations
from ailsrs_jax.host_calls import host_errors
from ailsrs_jax.runs.inverse_dynamics import infer_actions, one_step
from ailsrs_jax.trainers.ailsrs import make_ailsrs
from ailsrs_jax.trainers.algorithms import preset_settings
from ailsrs_jax.trainers.gail import make_gail
from ailsrs_jax.trainers.parts.reference import Reference, make_reference, unlike_the_others
from ailsrs_jax.trainers.parts.rollout import Simulator
from ailsrs_jax.trainers.parts.settings import override
from ailsrs_jax.trainers.parts.trainer import Trainer

NUM_PAIRS = 200  # steps that are simulated again
NUM_EPISODES = 10  # of each clone
FACTORS = (0.1, 0.5, 2.0, 10.0, float(180.0 / np.pi), float(np.pi / 180.0), -1.0)
UNLIKE = 5.0  # times the median distance of an episode to all
SAME = 0.05  # the largest difference to a simulated step, as a share of what the step changes
ALIKE = 0.6  # the smallest correlation of an entry's changes if the steps are of the same kind


@dataclasses.dataclass(frozen=True)
class Inspection:
    """Facts about demonstrations, by name, and what is wrong with them, one line each."""

    facts: dict[str, Any]
    problems: tuple[str, ...]


def inspect_demonstrations(demonstrations: Demonstrations, env: Env) -> Inspection:
    """Describe ``demonstrations`` of ``env``, which have its sizes and its range of actions."""
    facts: dict[str, Any] = {
        "episodes": demonstrations.num_trajectories,
        "transitions": int(np.sum(demonstrations.lengths)),
        "return_mean": float(np.mean(demonstrations.returns)),
        "return_std": float(np.std(demonstrations.returns)),
        "shortest": int(np.min(demonstrations.lengths)) * demonstrations.stride,
        "longest": int(np.max(demonstrations.lengths)) * demonstrations.stride,
        "every": demonstrations.stride,
        "sets_states": starts_at_observations(env),
    }
    problems = _problems(demonstrations)
    has_pairs = demonstrations.stride == 1 and bool(np.any(demonstrations.lengths > 1))
    every_step = facts["sets_states"] and has_pairs
    facts["actions_inferred"] = every_step and demonstrations.actions is None
    if facts["actions_inferred"]:
        demonstrations = infer_actions(demonstrations, env)
    if every_step:
        difference, problem = compare_steps(demonstrations, env)
        facts["difference_to_simulation"] = difference
        problems += [problem] if problem else []
    if demonstrations.actions is not None:
        facts["clipped_actions"] = _clipped_share(demonstrations, env)
        facts |= _linearity(demonstrations) | _clones(demonstrations, env)
    return Inspection(facts, tuple(problems))


def compare_steps(demonstrations: Demonstrations, env: Env) -> tuple[float, str | None]:
    """Simulate some of the recorded steps again.

    Returns:
        The median difference of an observation after a step to the recorded one, as a share of what
        the step changes; and what it says about the demonstrations, if it is too large.
    """
    observations, actions, following = _pairs(demonstrations)
    stepped = jax.jit(one_step(env))
    scale = np.median(np.abs(following - observations), axis=0)
    moving = scale > 1e-6

    def step(observations: np.ndarray, actions: np.ndarray) -> np.ndarray:
        with host_errors():
            return np.asarray(stepped(observations, actions))

    def difference(predicted: np.ndarray) -> float:
        errors = np.median(np.abs(predicted - following), axis=0)
        return float(np.median((errors / np.where(moving, scale, 1.0))[moving]))

    predicted = step(observations, actions)
    found = difference(predicted)
    if found <= SAME or not moving.any():
        return found, None
    for factor in FACTORS:
        if difference(step(observations, actions * factor)) <= SAME:
            return found, f"the actions are {1 / factor:.3g} times those of the environment"
        if difference(step(observations * factor, actions) / factor) <= SAME:
            return found, f"the observations are {1 / factor:.3g} times those of the environment"
    change, recorded = ((x - observations)[:, moving] for x in (predicted, following))
    power, common = (np.mean(change * x, axis=0) for x in (change, recorded))
    correlations = common / np.sqrt(power * np.mean(recorded**2, axis=0) + 1e-20)
    if np.mean(correlations >= ALIKE) < 0.5:
        return found, (
            "steps of the environment are nothing like the recorded ones: another task, or entries "
            "in another order"
        )
    ratio = float(np.median((common / power)[correlations >= ALIKE]))
    if abs(np.log(ratio)) > 0.3:
        return found, (
            f"a step of the demonstrations changes {ratio:.2g} times as much as a step of the "
            "environment: another frame skip or timestep"
        )
    return found, (
        f"a step of the environment differs from the recorded one by {100 * found:.0f} % of "
        "what it changes: another version of the environment, or noise"
    )


def _pairs(demonstrations: Demonstrations) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return some observations, actions and next observations, spread over all episodes."""
    alive = np.asarray(demonstrations.alive)
    episode, time = np.nonzero(alive[:, :-1] & alive[:, 1:])
    chosen = np.unique(np.linspace(0, max(len(time) - 1, 0), NUM_PAIRS).astype(int))[: len(time)]
    episode, time = episode[chosen], time[chosen]
    observations, actions = map(np.asarray, (demonstrations.observations, demonstrations.actions))
    return observations[episode, time], actions[episode, time], observations[episode, time + 1]


def _problems(demonstrations: Demonstrations) -> list[str]:
    """Return what is odd about single episodes and single entries of the observation."""
    problems = []
    time_steps = demonstrations.observations.shape[1]
    unlike = np.flatnonzero(unlike_the_others(_reference(demonstrations), time_steps, UNLIKE))
    if len(unlike):
        problems.append(f"episodes are unlike most, maybe falls: {_listed(unlike)}")
    steps = np.asarray(demonstrations.observations)[np.asarray(demonstrations.alive)]
    spread = steps.std(axis=0)
    constant = np.flatnonzero(spread < 1e-6)
    if len(constant):
        problems.append(f"entries of the observation are constant: {_listed(constant)}")
    _, first = np.unique(steps, axis=1, return_index=True)
    repeated_entries = np.setdiff1d(np.setdiff1d(np.arange(steps.shape[1]), first), constant)
    if len(repeated_entries):
        problems.append(f"entries repeat others: {_listed(repeated_entries)}")
    extreme = np.flatnonzero((spread > 100.0) | ((spread < 0.001) & (spread >= 1e-6)))
    if len(extreme):
        problems.append(
            f"the standard deviation of entries is far from 1: {_listed(extreme)}, from "
            f"{spread[extreme].min():.2g} to {spread[extreme].max():.2g}"
        )
    return problems


def _listed(entries: np.ndarray) -> str:
    shown = ", ".join(map(str, entries[:10]))
    return shown if len(entries) <= 10 else f"{shown} and {len(entries) - 10} more"


def _clipped_share(demonstrations: Demonstrations, env: Env) -> float:
    low, high = map(np.asarray, action_range(env))
    actions = np.asarray(demonstrations.actions)[np.asarray(demonstrations.alive)]
    slack = 1e-5 * (high - low)
    return float(np.mean((actions <= low + slack) | (actions >= high - slack)))


def _linearity(demonstrations: Demonstrations) -> dict[str, float]:
    """Fit linear policies to four fifths of the steps, and return their R² on the last fifth."""
    reference = _reference(demonstrations)
    alive = reference.alive
    order = jnp.cumsum(alive).reshape(alive.shape)
    fitted = alive & (order <= 0.8 * order.max())
    observations, actions = reference.observations, reference.actions
    held_out = alive & ~fitted
    affine = affine_regression(observations, actions, fitted)
    plain = jnp.pad(ridge_regression(observations, actions, fitted), [(0, 0), (0, 1)])
    # Of all steps: in the last ones alone, an expert that stands still does not vary.
    variance = jnp.var(actions, axis=(0, 1), where=alive[..., None]).mean()

    def r_squared(weights: jax.Array) -> float:
        errors = actions - observations @ weights[:, :-1].T - weights[:, -1]
        left = jnp.mean(jnp.square(errors), where=held_out[..., None])
        return float(1.0 - left / jnp.maximum(variance, 1e-12))

    return {"r_squared": r_squared(affine), "r_squared_without_intercept": r_squared(plain)}


def _reference(demonstrations: Demonstrations) -> Reference:
    return make_reference(demonstrations, demonstrations.time_limit, 1500)


def _clones(demonstrations: Demonstrations, env: Env) -> dict[str, float]:
    """Return the mean environment return of a linear and of a neural clone."""
    simulator, length = Simulator(env), demonstrations.time_limit
    changes = {"behavior_cloning_start": True, "standardize_with": "expert"}
    changes |= {"episode_length": length}
    linear = override(preset_settings("", "paper", "ailsrs"), changes | {"intercept": True})
    neural = override(preset_settings("", "paper", "gail"), changes)
    init_key, key = jax.random.key(0), jax.random.key(1)

    def evaluate(trainer: Trainer) -> float:
        policy = jax.jit(lambda: trainer.init(init_key).kept.policy)()
        run = jax.jit(lambda policy: simulator.evaluate(policy, key, NUM_EPISODES, length))
        with host_errors():
            return float(np.nanmean(np.asarray(run(policy).env_returns)))

    return {
        "linear_clone_return": evaluate(make_ailsrs(simulator, demonstrations, linear)),
        "neural_clone_return": evaluate(make_gail(simulator, demonstrations, neural)),
    }
