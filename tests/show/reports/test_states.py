"""The states of expert and policy, and the weights beside the clone's."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

import ailsrs_jax as ail
from ailsrs_jax.data.sources import Source, content_hash
from ailsrs_jax.runs import demonstrate
from ailsrs_jax.show.reports import states
from ailsrs_jax.show.reports.states import (
    NUM_PARTS,
    Met,
    differences,
    expert_reference,
    met_by,
    projection,
)
from ailsrs_jax.show.reports.weights import MOST_ENTRIES, weight_maps
from ailsrs_jax.trainers.parts.episodes import Episodes
from ailsrs_jax.trainers.parts.reference import Reference, make_reference
from tests.point_mass import linear_policy

RNG = np.random.default_rng(0)
WEIGHTS = RNG.normal(size=(3, 11))


def steps(observations: np.ndarray) -> Reference:
    """An expert on Hopper that is linear in its standardised observations (E, T, 11)."""
    num_episodes, length, _ = observations.shape
    given = ail.Demonstrations(
        observations=observations.astype(np.float32),
        actions=np.zeros((num_episodes, length, 3), np.float32),
        lengths=np.full(num_episodes, length, np.int32),
        returns=np.ones(num_episodes, np.float32),
        env_id="Hopper-v5",
    )
    expert = make_reference(given, length, 100)
    return expert.replace(actions=expert.observations @ WEIGHTS.T)


def policy(env_id: str = "Hopper-v5", n: int = 11) -> ail.SavedLinearPolicy:
    return linear_policy(np.resize(WEIGHTS, (3, n)), env_id, std=np.full(n, 4.0))


def test_the_expert_is_drawn_along_the_directions_in_which_it_varies() -> None:
    plane = RNG.normal(size=(2, 11)) * np.array([[3.0], [1.0]])
    expert = steps(RNG.normal(size=(4, 100, 2)) @ plane)
    states = np.asarray(expert.observations).reshape(400, 11)
    met = {"seed 1": Met(states, np.zeros(1), np.zeros(1))}
    chart = projection(expert, met, {"seed 1": "red"})
    mine, its = chart.panels[0].lines
    np.testing.assert_allclose(mine.x, its.x, atol=1e-5)
    assert mine.x.std() > mine.y.std() > 0
    # Two directions hold everything, so distances are kept.
    shares = [int(label.split("%")[0].split()[-1]) for label in labels(chart)]
    assert sum(shares) in (99, 100, 101)
    far = states[0] - states[1]
    drawn = np.hypot(mine.x[0] - mine.x[1], mine.y[0] - mine.y[1])
    assert drawn == pytest.approx(np.linalg.norm(far), rel=1e-4)


def test_where_policy_and_expert_differ_is_shown_over_the_episode() -> None:
    expert = steps(RNG.normal(size=(20, 100, 11)))
    alike = episodes_of(expert, np.full(20, 100))
    far = alike.replace(observations=alike.observations.at[:, 50:].add(3.0))
    fallen = alike.replace(lengths=jnp.full(20, 30))
    near, moved, short = (met_by(each, expert).distances for each in (alike, far, fallen))
    assert len(near) == NUM_PARTS
    assert near.max() < 0.2
    np.testing.assert_array_equal(moved[:10], near[:10])
    assert moved[10:].min() > 1
    np.testing.assert_array_equal(short[:6], near[:6])
    assert short[6:].min() > 1
    chart = differences({"seed 1": met_by(far, expert)}, {"seed 1": "red"})
    (line,) = chart.panels[0].lines
    np.testing.assert_array_equal(line.x, np.arange(0, 100, 5))
    np.testing.assert_array_equal(line.y, moved)


def test_a_thinned_expert_is_compared_at_the_same_times() -> None:
    whole = steps(RNG.normal(size=(100, 100, 11)))
    policy = episodes_of(whole, np.full(100, 100))
    policy = policy.replace(observations=policy.observations.at[:, 60:].add(3.0))
    kept = whole.observations[:, 2::10], whole.actions[:, 2::10]
    thinned = whole.replace(
        observations=kept[0], actions=kept[1], lengths=jnp.full(100, 10), stride=10
    )
    met = met_by(policy, thinned)
    np.testing.assert_array_equal(met.times, np.arange(0, 100, 10))
    assert met.distances[:6].max() < 0.5
    assert met.distances[6:].min() > 1
    cut = policy.replace(observations=policy.observations[:, :5], actions=policy.actions[:, :5])
    assert not len(met_by(cut, thinned).distances)  # shorter than a block of the thinned steps
    few = thinned.replace(lengths=thinned.lengths.at[1:].set(0))
    assert differences({"seed 1": met_by(policy, few)}, {"seed 1": "red"}) is None


def episodes_of(expert: Reference, lengths: np.ndarray) -> Episodes:
    """The expert's own steps as episodes of a policy."""
    num_episodes, limit, _ = expert.observations.shape
    return Episodes(
        observations=expert.unstandardize(expert.observations),
        actions=expert.actions,
        env_rewards=jnp.zeros((num_episodes, limit)),
        lengths=jnp.asarray(lengths),
        diverged=jnp.zeros(num_episodes, bool),
        final_observations=expert.observations[:, -1],
        slot_steps=jnp.zeros((), jnp.int32),
    )


def labels(chart: Any) -> tuple[str, str]:
    return chart.panels[0].x_label, chart.panels[0].y_label


def test_weights_have_names_and_the_clone_has_the_same_units() -> None:
    expert = steps(RNG.normal(size=(4, 100, 11)) * np.linspace(1, 2, 11))
    shown = weight_maps("policy of seed 2", policy(), expert)
    assert shown is not None
    assert shown.actions == ["thigh_joint", "leg_joint", "foot_joint"]
    mine, clone = shown.maps.values()
    assert [entry for entry, _ in mine][:2] == ["rootz", "rooty"]
    assert mine[-1][0] == "foot_joint velocity"
    np.testing.assert_allclose([row for _, row in clone], WEIGHTS.T, atol=2e-3)
    units = (np.asarray(expert.statistics.std) / 4)[:, None]
    np.testing.assert_allclose([row for _, row in mine], WEIGHTS.T * units, rtol=1e-5)
    alone = weight_maps("policy", policy(), None)
    assert alone is not None
    assert list(alone.maps) == ["policy"]


def test_only_the_largest_weights_of_many_are_shown() -> None:
    wide = policy("nothing:known", 50)
    wide.weights[:, 7] = 100.0
    shown = weight_maps("policy", wide, None)
    assert shown is not None
    entries = [entry for entry, _ in shown.maps["policy"]]
    assert len(entries) == MOST_ENTRIES
    assert "entry 7" in entries
    assert "The 18 entries with the smallest weights are left out." in shown.caption
    assert weight_maps("expert", ail.load_expert("hopper"), None) is None  # a neural network


def test_only_demonstrations_in_the_cache_with_the_same_hash_are_used(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    given = ail.Demonstrations(
        observations=RNG.normal(size=(2, 5, 3)).astype(np.float32),
        actions=RNG.normal(size=(2, 5, 1)).astype(np.float32),
        lengths=np.array([5, 2], np.int32),
        returns=np.ones(2, np.float32),
        env_id="Hopper-v5",
    )
    config = {"env_id": "Hopper-v5", "num_trajectories": 2, "physics": "mujoco", "subsample": 1}
    config["settings"] = {}
    config["demonstrations_sha256"] = content_hash(given)
    run: Any = SimpleNamespace(config=config, source=Source("expert"))
    # Nothing is simulated for a run that says so.
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(demonstrate, "demonstrate", None)
    assert expert_reference(run) is None
    monkeypatch.setattr(states, "expert_demonstrations", lambda *_, **__: given)
    found = expert_reference(run)
    assert found is not None
    observations = np.asarray(found.observations[found.alive])
    assert observations.shape == (7, 3)
    np.testing.assert_allclose(observations.mean(axis=0), 0, atol=1e-5)
    np.testing.assert_allclose(observations.std(axis=0), 1, atol=1e-5)
    config["settings"] = {"discriminator_entries": "a stranger's"}
    assert expert_reference(run) is None
    config["settings"] = {}
    run.source = Source("file", "/etc/passwd")
    assert expert_reference(run) is None
    run.source = Source("expert")
    config["demonstrations_sha256"] = "0" * 64
    assert expert_reference(run) is None
