"""``ailsrs compare``, against numbers worked out by hand."""

import json
import math
import re
from pathlib import Path
from typing import Any

import pytest

from ailsrs_jax.cli.main import main
from ailsrs_jax.errors import UserError
from ailsrs_jax.runs.inspection.comparison import POINTS, compare_runs
from ailsrs_jax.runs.storage.saved_run import read_run
from ailsrs_jax.show.reports.sweep_page import comparison_page
from tests.runs.toy_run import SEEDS
from tests.show.reports.test_report import write_run

METRICS = """iteration,seed,env_steps,evaluation_return,expert_distance
0,{0},100,2,3
0,{1},100,4,3
1,{0},300,9,1
1,{1},400,8,2
2,{0},900,10,0.5
2,{1},1000,6,2.5
"""
SECONDS = "iteration,seconds,compile_seconds\n0,1,5\n1,2,0\n2,4,0\n"


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of two seeds whose records are made up; the expert's return is 10."""
    path = write_run(tmp_path_factory.mktemp("runs") / "made_up", seeds=SEEDS, env_id="Task")
    (path / "metrics.csv").write_text(METRICS.format(*SEEDS))
    (path / "seconds.csv").write_text(SECONDS)
    result = json.loads((path / "result.json").read_text())
    result["expert_return"]["mean"] = 10.0
    result["seeds"] = {
        str(seed): {"kept_iteration": kept, "score": 0.0}
        for seed, kept in zip(SEEDS, (2, 1), strict=True)
    }
    (path / "result.json").write_text(json.dumps(result))
    return path


def test_the_records_are_summarised(recorded: Path) -> None:
    found = compare_runs([recorded])
    (summary,) = found.runs
    assert found.max_steps == 1000
    assert (summary.algorithm, summary.num_seeds) == ("AILSRS", 2)
    assert (summary.return_mean, summary.distance) == (9.0, 1.25)  # means of 10, 8 and 0.5, 2
    assert summary.steps_to_90 == summary.seconds_to_90 == math.inf  # the second never gets there
    assert len(summary.course) == POINTS
    assert summary.course[0] == 3.0
    assert summary.course[-1] == 8.0


def test_the_cost_is_the_median_over_seeds(recorded: Path, tmp_path: Path) -> None:
    rows = METRICS.replace("400,8,2", "400,9,2").format(*SEEDS)
    for path in recorded.glob("*.*"):
        (tmp_path / path.name).write_bytes(path.read_bytes())
    (tmp_path / "metrics.csv").write_text(rows)
    (summary,) = compare_runs([tmp_path]).runs
    assert (summary.steps_to_90, summary.seconds_to_90) == (350.0, 8.0)
    (tmp_path / "seconds.csv").write_text("".join(SECONDS.splitlines(keepends=True)[:2]))
    (summary,) = compare_runs([tmp_path]).runs
    assert summary.steps_to_90 == math.inf
    (tmp_path / "seconds.csv").write_text("iteration,seconds\n0,1\n")
    with pytest.raises(UserError, match="does not have the columns"):
        compare_runs([tmp_path])
    (tmp_path / "seconds.csv").write_text(SECONDS)
    (tmp_path / "metrics.csv").write_text("".join(rows.splitlines(keepends=True)[:5]))
    with pytest.raises(UserError, match=r"metrics.csv has no iteration \d of seed \d"):
        compare_runs([tmp_path])


def test_experts_with_a_negative_return_or_other_episodes(recorded: Path, tmp_path: Path) -> None:
    for path in recorded.glob("*.*"):
        (tmp_path / path.name).write_bytes(path.read_bytes())
    result = json.loads((tmp_path / "result.json").read_text())
    result["expert_return"]["mean"] = -3.0
    rows = METRICS.replace("100,4,3", "100,-4,3").replace("400,8,2", "400,-3.3,2").format(*SEEDS)
    (tmp_path / "metrics.csv").write_text(rows)
    (tmp_path / "result.json").write_text(json.dumps(result))
    # 0.9 of a negative return is a tenth below it.
    assert compare_runs([tmp_path]).runs[0].steps_to_90 == 250.0  # of 100 and 400
    result["expert_return"]["episode_length"] = 999
    (tmp_path / "result.json").write_text(json.dumps(result))
    (summary,) = compare_runs([tmp_path]).runs
    assert summary.expert_return is summary.steps_to_90 is summary.seconds_to_90 is None
    with pytest.raises(UserError, match="name the directories"):
        compare_runs([])


def test_each_expert_has_a_line(recorded: Path, tmp_path: Path) -> None:
    for path in recorded.glob("*.*"):
        (tmp_path / path.name).write_bytes(path.read_bytes())
    (tmp_path / "result.json").write_text(
        (recorded / "result.json").read_text().replace("10.0", "20.0")
    )
    first, second = read_run(recorded), read_run(tmp_path)
    for runs, levels in (
        ({"a": first, "b": first}, {"expert": 10.0}),
        ({"a": first, "b": first, "c": second}, {"expert of a, b": 10.0, "expert of c": 20.0}),
    ):
        assert comparison_page(runs, [], [], "").parts[1].panels[0].levels == levels


def test_the_command(recorded: Path, monkeypatch: Any, capsys: Any) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    monkeypatch.chdir(recorded.parent)
    monkeypatch.setattr("sys.argv", ["ailsrs", "compare", recorded.name, str(recorded)])
    main()
    printed = capsys.readouterr().out
    assert printed.count("AILSRS, 2 seeds") == 2
    assert printed.count("90 %") == printed.count("never") == 2
    assert max(map(len, printed.splitlines())) <= 80
    page = recorded.parent / "page.html"
    monkeypatch.setattr("sys.argv", ["ailsrs", "compare", str(recorded), "--output", str(page)])
    main()
    assert capsys.readouterr().out.endswith(f"{page}\n")
    html = page.read_text()
    assert "<td>90 %</td>" in re.sub(r"\s*(</?td)[^>]*>\s*", r"\1>", html)
    assert "energy distance to expert" in html
    monkeypatch.setattr("sys.argv", ["ailsrs", "compare", str(recorded), "--json"])
    main()
    (entry,) = json.loads(capsys.readouterr().out)["runs"]
    assert (entry["return_mean"], entry["steps_to_90"]) == (9.0, None)
