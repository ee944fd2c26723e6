"""The states of expert and policy, and the weights beside the clone's."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import ailsrs_jax as ail
from ailsrs_jax.data.sources import Source, content_hash
from ailsrs_jax.runs import demonstrate
from ailsrs_jax.show.reports import states
from ailsrs_jax.show.reports.states import ExpertSteps, expert_steps, projection
from ailsrs_jax.show.reports.weights import MOST_ENTRIES, weight_maps

RNG = np.random.default_rng(0)
WEIGHTS = RNG.normal(size=(3, 11))


def steps() -> ExpertSteps:
    """An expert on Hopper that is linear; its states vary in two directions only."""
    plane = RNG.normal(size=(2, 11)) * np.array([[3.0], [1.0]])
    observations = RNG.normal(size=(400, 2)) @ plane
    std = np.linspace(1, 2, 11)
    return ExpertSteps(observations, observations @ WEIGHTS.T, np.ones(11), std)


def policy(env_id: str = "Hopper-v5", n: int = 11) -> ail.SavedLinearPolicy:
    ones = np.ones(3)
    return ail.SavedLinearPolicy(
        weights=np.resize(WEIGHTS, (3, n)),
        mean=np.zeros(n),
        std=np.full(n, 4.0),
        action_low=-ones,
        action_high=ones,
        env_id=env_id,
    )


def test_the_expert_is_drawn_along_the_directions_in_which_it_varies() -> None:
    expert = steps()
    same = expert.observations * expert.std + expert.mean
    chart = projection(expert, {"seed 1": same}, {"seed 1": "red"})
    mine, its = chart.panels[0].lines
    np.testing.assert_allclose(mine.x, its.x, atol=1e-9)
    assert mine.x.std() > mine.y.std() > 0
    # Two directions hold everything, so distances are kept.
    shares = [int(label.split("%")[0].split()[-1]) for label in labels(chart)]
    assert sum(shares) in (99, 100, 101)
    far = expert.observations[0] - expert.observations[1]
    drawn = np.hypot(mine.x[0] - mine.x[1], mine.y[0] - mine.y[1])
    assert drawn == pytest.approx(np.linalg.norm(far))


def labels(chart: Any) -> tuple[str, str]:
    return chart.panels[0].x_label, chart.panels[0].y_label


def test_weights_have_names_and_the_clone_has_the_same_units() -> None:
    expert = steps()._replace(observations=RNG.normal(size=(400, 11)))
    expert = expert._replace(actions=expert.observations @ WEIGHTS.T)
    shown = weight_maps("policy of seed 2", policy(), expert)
    assert shown is not None
    assert shown.actions == ["thigh_joint", "leg_joint", "foot_joint"]
    mine, clone = shown.maps.values()
    assert [entry for entry, _ in mine][:2] == ["rootz", "rooty"]
    assert mine[-1][0] == "foot_joint velocity"
    np.testing.assert_allclose([row for _, row in clone], WEIGHTS.T, atol=2e-3)
    units = (expert.std / 4)[:, None]
    np.testing.assert_allclose([row for _, row in mine], WEIGHTS.T * units, rtol=1e-6)
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
    config["demonstrations_sha256"] = content_hash(given)
    run: Any = SimpleNamespace(config=config, source=Source("expert"))
    # Nothing is simulated for a run that says so.
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(demonstrate, "demonstrate", None)
    assert expert_steps(run) is None
    monkeypatch.setattr(states, "expert_demonstrations", lambda *_, **__: given)
    found = expert_steps(run)
    assert found is not None
    assert found.observations.shape == (7, 3)
    np.testing.assert_allclose(found.observations.mean(axis=0), 0, atol=1e-5)
    np.testing.assert_allclose(found.observations.std(axis=0), 1, atol=1e-5)
    run.source = Source("file", "/etc/passwd")
    assert expert_steps(run) is None
    run.source = Source("expert")
    config["demonstrations_sha256"] = "0" * 64
    assert expert_steps(run) is None
