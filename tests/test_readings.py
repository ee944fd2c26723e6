"""The clones of experiments/readings.py."""

import json
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("experiments.readings", reason="the package is installed without it")
from experiments import readings
from experiments.evidence import HOPPER, SWIMMER


def test_unclipped_actions_are_what_the_expert_asked_for() -> None:
    clipped, free = (readings.read_demonstrations(SWIMMER, "linear", 2, x) for x in (True, False))
    assert np.abs(free.actions).max() > 1.5
    np.testing.assert_allclose(np.clip(free.actions, -1, 1), clipped.actions, atol=1e-4)


def test_only_shares_close_to_the_papers_are_bold(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    reading = {"expert": "linear", "clipped": False, "training": "5 passes"}
    rows = [
        reading | {"env_id": HOPPER, "number": 10, "shares": [0.4, 0.5]},
        reading | {"env_id": HOPPER, "number": 40, "shares": [0.5, 0.5]},
    ]
    monkeypatch.setattr(readings, "RESULTS", tmp_path / "readings.json")
    (tmp_path / "readings.json").write_text(json.dumps(rows))
    *_, line = readings.table().splitlines()
    assert line == "| linear | unclipped | 5 passes | – | – | **0.45** | 0.50 | – | – | – |"
