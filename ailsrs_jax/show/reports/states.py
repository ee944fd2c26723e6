"""Where the states of policies are beside those of the expert that a run learned from."""

from collections.abc import Mapping
from typing import NamedTuple

import jax
import numpy as np

from ailsrs_jax.components.energy_distance import energy_distance, mean_distance
from ailsrs_jax.data.sources import content_hash
from ailsrs_jax.errors import UserError
from ailsrs_jax.runs.demonstrate import expert_demonstrations
from ailsrs_jax.runs.storage.saved_run import SavedRun
from ailsrs_jax.show.reports.charts import Chart, Line, Panel
from ailsrs_jax.trainers.parts.adversary import AdversarySettings
from ailsrs_jax.trainers.parts.episodes import Episodes
from ailsrs_jax.trainers.parts.reference import (
    Reference,
    distance_features,
    distance_horizon,
    make_reference,
)
from ailsrs_jax.trainers.parts.settings import override

NUM_STATES = 500  # of each cloud
NUM_PARTS = 20  # of an episode, at most
STEPS_OF_A_PART = 100  # demonstrated ones, in the mean, that its distance needs
NUM_COMPARED = 250  # steps of each part, from each side
EXPERT = "expert"
USED = ("discriminator_entries", "leave_out_beyond")  # settings


class Met(NamedTuple):
    """What is shown of the states that a policy met."""

    states: np.ndarray  # (≤ NUM_STATES, n) in units of the expert's standard deviation
    times: np.ndarray  # (≤ NUM_PARTS,) the first step of each part of an episode
    distances: np.ndarray  # of each part, the energy distance to the expert


def expert_reference(run: SavedRun) -> Reference | None:
    """Return the demonstrations of the shipped expert if they are in the cache and the run's own.

    No file that the run names is opened: a stranger's run could name any file.
    """
    config, source = run.config, run.source
    if source is None or source.kind != "expert":
        return None
    env_id, number, physics = (config[name] for name in ("env_id", "num_trajectories", "physics"))
    try:
        given = expert_demonstrations(env_id, number, physics, source.name, only_cached=True)
        if config["subsample"] != 1:
            given = given.subsample(config["subsample"])
        if content_hash(given) != config["demonstrations_sha256"] or given.actions is None:
            return None
        used = {name: value for name, value in config["settings"].items() if name in USED}
        settings = override(AdversarySettings(), used)
        entries, beyond = settings.discriminator_entries, settings.leave_out_beyond
        return make_reference(given, given.time_limit, NUM_STATES, entries, beyond)
    except UserError:
        return None


def met_by(episodes: Episodes, expert: Reference) -> Met:
    """Return what is shown of the states of ``episodes``."""
    usable = np.argwhere(episodes.usable)
    states = expert.statistics.standardize(episodes.observations[tuple(_some(usable).T)])
    stride, episode_length = expert.stride, episodes.observations.shape[1]
    num_blocks = distance_horizon(expert.observations, stride, episode_length)
    enough = max(int(expert.lengths.sum()) // STEPS_OF_A_PART, 1)
    num_parts = min(NUM_PARTS, num_blocks, enough)
    starts = np.linspace(0, num_blocks, num_parts, endpoint=False).astype(int)
    size = num_blocks // max(num_parts, 1)  # that of the smallest, so that one program serves all

    def distance(start: int) -> float:
        key, expert_key = jax.random.split(jax.random.fold_in(jax.random.key(0), start))
        its, lengths = expert.points[:, start : start + size], expert.lengths - start
        its = distance_features(expert_key, its, lengths, size, NUM_COMPARED)
        first, after = start * stride, (start + size) * stride
        seen = episodes.observations[:, first:after], episodes.actions[:, first:after]
        mine, lengths = expert.points_of(*seen), episodes.usable_lengths - first
        mine = distance_features(key, mine, lengths, after - first, NUM_COMPARED)
        return float(energy_distance(mine, its, mean_distance(its, its)))

    distances = np.array([distance(int(start)) for start in starts])
    return Met(np.asarray(states), starts * stride, distances)


def projection(expert: Reference, met: Mapping[str, Met], colors: Mapping[str, str]) -> Chart:
    """Draw states by the name of the policy on the two directions in which the expert's vary most.

    These are the principal components of the expert's standardised observations, by a singular
    value decomposition.
    """
    demonstrated = np.asarray(expert.observations[expert.alive])
    _, spreads, axes = np.linalg.svd(demonstrated - demonstrated.mean(axis=0), full_matrices=False)
    shares = spreads**2 / max(float(np.sum(spreads**2)), 1e-12)
    clouds = {EXPERT: _some(demonstrated)} | {name: each.states for name, each in met.items()}
    lines = [
        Line(name, cloud @ axes[0], cloud @ axes[1], "cloud") for name, cloud in clouds.items()
    ]
    x_label, y_label = (
        f"component {index + 1}, {100 * shares[index]:.0f} % of the variance" for index in (0, 1)
    )
    return Chart(
        "States",
        [Panel("", x_label, y_label, lines)],
        {EXPERT: "var(--ink)"} | dict(colors),
        f"Each dot is a state, {NUM_STATES} of each. The axes are the two directions in which the "
        "expert's states vary most. A policy is like the expert where its dots cover the expert's.",
    )


def differences(met: Mapping[str, Met], colors: Mapping[str, str]) -> Chart | None:
    """Draw the energy distance of each policy to the expert over the time of an episode.

    Returns None if there are too few demonstrated steps to tell parts of an episode apart.
    """
    if any(len(each.times) < 2 for each in met.values()):
        return None
    lines = [Line(name, each.times, each.distances) for name, each in met.items()]
    return Chart(
        "Where in an episode they differ",
        [Panel("", "step of the episode", "energy distance", lines, limits=(0.0, None))],
        colors,
        "The energy distance of states and actions to the expert's, in each part of an episode. "
        "The time after an episode's end counts as a state of its own.",
    )


def _some(rows: np.ndarray) -> np.ndarray:
    """Return at most ``NUM_STATES`` of the ``rows``, evenly."""
    return rows[np.linspace(0, len(rows) - 1, min(NUM_STATES, len(rows))).astype(int)]
