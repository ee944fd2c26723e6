"""What docs/own_task.md says about a task of one's own, followed to the letter."""

import re
import shlex
from pathlib import Path

import numpy as np
import pytest

from ailsrs_jax.data.demonstrations import load_demonstrations
from ailsrs_jax.data.policies import load_policy
from tests.test_cli import TINY, ailsrs

PAGE = Path(__file__).parent.parent / "docs" / "own_task.md"

# Added to each command as it stands, so that it takes seconds.
SMALLER = {
    "expert": "--set num_iterations=2 num_directions=2 num_top_directions=1 episode_length=10",
    "demonstrate": "--num-trajectories 3",
    "train": f"--set num_iterations=2 {' '.join(TINY)}",
    "evaluate": "--episodes 2",
}


def test_a_task_of_ones_own(in_tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys) -> None:
    blocks = dict(reversed(re.findall(r"```(\w+)\n(.*?)```", PAGE.read_text(), re.DOTALL)))
    Path("slider.xml").write_text(blocks["xml"])
    Path("my_tasks.py").write_text(blocks["python"])
    for line in blocks["sh"].splitlines():
        program, command, *arguments = shlex.split(line)
        assert program == "ailsrs"
        assert ailsrs(monkeypatch, command, *arguments, *SMALLER[command].split()) == 0, line
    assert load_demonstrations("slider.npz").observations.shape == (3, 1000, 2)
    assert load_policy("runs/slider/seed_0/policy.npz").env_id == "my_tasks:Slider"
    *_, returns, length = capsys.readouterr().out.splitlines()[-1].split()
    assert length == "1000"
    assert np.isfinite(float(returns))

    assert ailsrs(monkeypatch, "evaluate", "runs/slider") == 2
    assert "Gymnasium has no my_tasks:Slider: choose physics auto" in capsys.readouterr().err
