"""The expert's steps that a run learned from, and a picture of its and the policies' states."""

from collections.abc import Mapping
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from ailsrs_jax.components import normalizer
from ailsrs_jax.data.sources import content_hash
from ailsrs_jax.errors import UserError
from ailsrs_jax.runs.demonstrate import expert_demonstrations
from ailsrs_jax.runs.storage.saved_run import SavedRun
from ailsrs_jax.show.reports.charts import Chart, Line, Panel
from ailsrs_jax.trainers.parts.episodes import Episodes

NUM_STATES = 500  # of each cloud
EXPERT = "expert"


class ExpertSteps(NamedTuple):
    """All steps of the demonstrations of a run."""

    observations: np.ndarray  # (m, n) in units of their standard deviation
    actions: np.ndarray  # (m, p)
    mean: np.ndarray  # (n,)
    std: np.ndarray  # (n,)


def expert_steps(run: SavedRun) -> ExpertSteps | None:
    """Return the demonstrations of the shipped expert if they are in the cache and the run's own.

    No file that the run names is opened: a stranger's run could name any file.
    """
    config, source = run.config, run.source
    if source is None or source.kind != "expert":
        return None
    env_id, number, physics = (config[name] for name in ("env_id", "num_trajectories", "physics"))
    of_paper = source.name is not None
    try:
        given = expert_demonstrations(env_id, number, physics, of_paper=of_paper, only_cached=True)
        if config["subsample"] != 1:
            given = given.subsample(config["subsample"])
    except UserError:
        return None
    if content_hash(given) != config["demonstrations_sha256"] or given.actions is None:
        return None
    alive, observations = np.asarray(given.alive), np.asarray(given.observations)
    none_yet = normalizer.init(observations.shape[-1])
    statistics = normalizer.update(none_yet, jnp.asarray(observations), jnp.asarray(alive))
    mean, std = np.asarray(statistics.mean), np.asarray(statistics.std)
    standardized = (observations[alive] - mean) / std
    return ExpertSteps(standardized, np.asarray(given.actions)[alive], mean, std)


def some_states(episodes: Episodes) -> np.ndarray:
    """Return observations ``(≤ NUM_STATES, n)`` of live steps, evenly over the episodes."""
    usable = np.flatnonzero(np.asarray(episodes.usable))
    observations = np.asarray(episodes.observations)
    return _some(observations.reshape(-1, observations.shape[-1]), usable)


def projection(
    expert: ExpertSteps, states: Mapping[str, np.ndarray], colors: Mapping[str, str]
) -> Chart:
    """Draw states ``(m, n)`` by name on the two directions in which the expert's vary most.

    These are the principal components of the expert's standardised observations, by a singular
    value decomposition.
    """
    centered = expert.observations - expert.observations.mean(axis=0)
    _, spreads, axes = np.linalg.svd(centered, full_matrices=False)
    shares = spreads**2 / max(float(np.sum(spreads**2)), 1e-12)
    clouds = {EXPERT: _some(expert.observations, np.arange(len(expert.observations)))}
    clouds |= {name: (each - expert.mean) / expert.std for name, each in states.items()}
    lines = []
    for name, cloud in clouds.items():
        x, y = axes[:2] @ cloud.T
        lines.append(Line(name, x, y, "cloud"))
    first, second = (f"{100 * share:.0f} % of the variance" for share in shares[:2])
    return Chart(
        "States",
        [Panel("", f"component 1, {first}", f"component 2, {second}", lines)],
        {EXPERT: "var(--ink)"} | dict(colors),
        f"Each dot is a state, {NUM_STATES} of each. The axes are the two directions in which the "
        "expert's states vary most. A policy is like the expert where its dots cover the expert's.",
    )


def _some(rows: np.ndarray, indices: np.ndarray) -> np.ndarray:
    few = np.linspace(0, len(indices) - 1, min(NUM_STATES, len(indices))).astype(int)
    return rows[indices[few]]
