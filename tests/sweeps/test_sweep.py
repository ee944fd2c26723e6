"""Sweeps of tiny cells: finished once, and never lost."""

import dataclasses
import json
from pathlib import Path
from typing import Any

import pytest

import ailsrs_jax as ail
from ailsrs_jax.cli.progress import SweepProgress
from ailsrs_jax.sweeps.spec import expand, read_spec
from ailsrs_jax.sweeps.sweep import choose_units, run_units
from tests.cli.test_cli import ailsrs
from tests.sweeps.toy_sweep import POINT_MASS, SEARCH, Watch, grid, quick_grid, table, two_cells


@pytest.mark.parametrize("max_parallel", [1, 64])
def test_cells_are_skipped_resumed_and_retried(
    in_tmp_path: Path, one_by_one: tuple[Path, list[Any]], max_parallel: int
) -> None:
    """The tables are the same, byte for byte."""
    spec = two_cells()
    arguments: dict[str, Any] = {"max_parallel": max_parallel}
    directory, whole = one_by_one
    if max_parallel > 1:
        directory = Path("whole")
        whole = ail.sweep(spec, directory, **arguments)
    names = [row["cell"] for row in whole]
    num_reports = 24 if max_parallel == 1 else 12

    # Stopped in the last iteration but one, after the checkpoint of iteration 10.
    stopped = Watch(KeyboardInterrupt(), at=num_reports - 2)
    with pytest.raises(KeyboardInterrupt):
        ail.sweep(spec, "stopped", watch=stopped, **arguments)
    done = names[: 1 if max_parallel == 1 else 0]
    rows = table(Path("stopped/results.csv"))
    assert [row["cell"] for row in rows] == names
    assert [row["cell"] for row in rows if row["status"] == "done"] == done
    assert [row["status"] for row in rows[len(done) :]] == ["not run"] * (2 - len(done))
    resumed = Watch()
    assert ail.sweep(spec, "stopped", watch=resumed, **arguments) == whole
    assert (resumed.begun, resumed.num_reports) == (names[len(done) :], 2)
    assert [row["cell"] for row in resumed.rows] == resumed.begun

    failing = Watch(RuntimeError("no\nmemory"), at=3)
    rows = ail.sweep(spec, "failed", watch=failing, **arguments)
    failed = "failed: RuntimeError: no"
    assert [row["status"] for row in rows] == [failed, "done" if max_parallel == 1 else failed]
    assert failing.rows == rows
    written = table(Path("failed/results.csv"))
    assert [row["status"] for row in written] == [row["status"] for row in rows]
    assert ail.sweep(spec, "failed", **arguments) == whole

    again = Watch()
    ail.sweep(spec, directory, watch=again, **arguments)
    assert again.begun == []
    for name in ("results.csv", "curves.csv"):
        for other in ("stopped", "failed"):
            assert Path(other, name).read_bytes() == (directory / name).read_bytes()
    assert not list(Path().glob("*/stacks/*"))


@pytest.mark.parametrize("max_parallel", [1, 64])
def test_told_to_stop_it_saves_first(in_tmp_path: Path, max_parallel: int) -> None:
    sweep = expand(quick_grid(seeds=[0, 1], settings={"num_iterations": 9}))
    units = choose_units(sweep, (0, 1), max_parallel)
    watch, output = Watch(), Path("sweep")

    def stop() -> bool:
        return watch.num_reports >= 3

    with pytest.raises(KeyboardInterrupt):
        run_units(sweep, units, output, watch=watch, stop=stop)
    assert watch.num_reports == 4
    assert [path.name for path in output.rglob("checkpoints/4")] == ["4"]


def test_a_stack_is_not_split_before_it_is_finished(in_tmp_path: Path) -> None:
    spec = two_cells()
    with pytest.raises(KeyboardInterrupt):
        ail.sweep(spec, "sweep", watch=Watch(KeyboardInterrupt(), at=11))
    cells = [path for path in Path("sweep/cells").iterdir() if path.is_dir()]
    for cell in cells:  # each is a run directory
        assert list(cell.glob("seed_*/policy.npz"))
        assert list(cell.glob("seed_*/iterations/8.npz"))
    rows = [(cell / "metrics.csv").read_bytes() for cell in cells]
    with pytest.raises(ail.UserError, match="begun with another --max-parallel"):
        ail.sweep(spec, "sweep", max_parallel=1)
    assert rows == [(cell / "metrics.csv").read_bytes() for cell in cells]
    ail.sweep(spec, "sweep")
    assert not list(Path("sweep/stacks").iterdir())


def test_a_cell_with_a_checkpoint_of_its_own_goes_on_alone(
    in_tmp_path: Path, one_by_one: tuple[Path, list[Any]]
) -> None:
    spec = quick_grid(seeds=[0, 1, 2], settings={"num_iterations": 12})
    _, alone = one_by_one
    with pytest.raises(KeyboardInterrupt):
        ail.sweep(spec, "sweep", max_parallel=1, watch=Watch(KeyboardInterrupt(), at=10))
    stopped = Watch(KeyboardInterrupt(), at=2 + 10)
    with pytest.raises(KeyboardInterrupt):
        ail.sweep(spec, "sweep", watch=stopped)  # trains the other two together
    assert stopped.rows == alone[:1]
    Path("sweep/cells", alone[0]["cell"], "row.json").unlink()
    resumed = Watch()
    rows = ail.sweep(spec, "sweep", watch=resumed)
    assert rows[0] == alone[0]
    assert [row["status"] for row in rows] == ["done"] * 3
    assert resumed.begun == [row["cell"] for row in rows]
    assert resumed.num_reports == 2  # of the two


def test_what_is_left_of_a_stack_is_all_that_is_trained(in_tmp_path: Path) -> None:
    spec = quick_grid(seeds=[0, 1, 2], settings={"num_iterations": 12})
    with pytest.raises(KeyboardInterrupt):
        ail.sweep(spec, "sweep", max_parallel=1, watch=Watch(KeyboardInterrupt(), at=10))
    first = expand(spec).cells[0].name
    config = Path("sweep/cells", first, "config.json")
    text = config.read_text()
    config.write_text("damaged")
    failed = ail.sweep(spec, "sweep")  # the other two together
    assert [row["status"] == "done" for row in failed] == [False, True, True]
    config.write_text(text)
    again = Watch()
    rows = ail.sweep(spec, "sweep", watch=again)
    assert [row["status"] for row in rows] == ["done"] * 3
    assert (again.begun, again.num_reports) == ([first], 2)
    assert not list(Path("sweep/stacks").iterdir())


def test_another_sweep_is_not_mixed_in(in_tmp_path: Path) -> None:
    expand(quick_grid()).save(Path("sweep/sweep.json"))
    (cell,) = expand(quick_grid()).cells
    other = cell.name.replace("seed0", "seed1")
    calls = {
        f"the number of cells is 2, was 1; cell 1 is {other}, was not there": {"seeds": [0, 1]},
        f"label of {cell.name} is ours, was ARS; choose": {"label": "ours"},
        f"cell 0 is {other}, was {cell.name}; ": {"seeds": 1},
        "episodes is 3, was 2; choose": {},
    }
    for message, entry in calls.items():
        spec = quick_grid(**entry) | ({} if entry else {"episodes": 3})
        with pytest.raises(ail.UserError, match="sweep holds another sweep: ") as caught:
            ail.sweep(spec, "sweep")
        assert message in str(caught.value)


def test_a_directory_that_cannot_be(in_tmp_path: Path) -> None:
    with pytest.raises(ail.UserError, match="File name too long"):
        ail.sweep(quick_grid(), "x" * 300)


def test_a_preset_that_has_changed_since(demonstrations: str) -> None:
    sweep = expand(grid(demonstrations))
    sweep.save(Path("sweep.json"))
    (cell,) = sweep.cells
    changed = dataclasses.replace(cell, all_settings=cell.all_settings | {"step_size": 0.5})
    with pytest.raises(ail.UserError, match=r"step_size of .* is 0\.5, was 0\.03; choose"):
        dataclasses.replace(sweep, cells=(changed,)).save(Path("sweep.json"))


def test_the_command_line(in_tmp_path: Path, monkeypatch, capsys) -> None:
    settings = "\n".join(
        f"{name} = {value}" for name, value in (SEARCH | {"num_directions": 4}).items()
    )
    Path("tiny.toml").write_text(
        f"""
        episodes = 2
        env = "{POINT_MASS}"
        algorithm = "ars"
        seeds = [0, 1]
        [settings]
        {settings}
        [[grid]]
        """
    )
    assert ailsrs(monkeypatch, "sweep", "tiny.toml", "--dry-run") == 2
    assert f"repeat its name with --own {POINT_MASS}" in capsys.readouterr().err
    options = ("--dry-run", "--output", "out", "--own", POINT_MASS)
    assert ailsrs(monkeypatch, "sweep", "tiny.toml", *options) == 0
    # Two cells, three iterations, four directions with two signs, eight evaluation episodes.
    printed = capsys.readouterr().out
    assert f"2 cells in 1 programs, at most {2 * 3 * 16 * 20 / 1e6:.1f} M steps" in printed
    assert ailsrs(monkeypatch, "sweep", "tiny.toml", "--dry-run", "--json", "--quiet") == 0
    (planned,) = json.loads(capsys.readouterr().out)["to_train"]
    assert (planned["num_cells"], planned["env_steps"]) == (2, 2 * 3 * 16 * 20)
    assert ailsrs(monkeypatch, "sweep", "tiny.toml", "--shard", "half") == 2
    assert "--shard half: write I/N" in capsys.readouterr().err
    assert ailsrs(monkeypatch, "sweep", "tiny.toml", "--shard", f"0/{'9' * 5000}") == 2
    assert capsys.readouterr().err.startswith("ailsrs: --shard 0/999")
    assert not Path("out").exists()
    expand(quick_grid()).save(Path("other/sweep.json"))
    assert ailsrs(monkeypatch, "sweep", "tiny.toml", "--dry-run", "--output", "other") == 2
    assert "other holds another sweep" in capsys.readouterr().err

    def interrupt(*arguments: Any) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr(SweepProgress, "__call__", interrupt)
        assert ailsrs(patched, "sweep", "tiny.toml", "--output", "out") == 130
    assert "saved; continue with:\nailsrs sweep tiny" in capsys.readouterr().err
    assert ailsrs(monkeypatch, "sweep", "tiny.toml", "--output", "out") == 0
    printed = capsys.readouterr().out
    assert "2/2  tests.point" in printed
    assert "2 of 2 cells done; table.md, figures/ and results.csv are in out" in printed
    assert Path("out/table.md").exists()
    assert list(Path("out/figures").glob("*.png"))

    # A different run takes the place of one cell.
    cell = expand(read_spec(Path("tiny.toml"))).cells[1].name
    Path("out/cells", cell, "row.json").unlink()
    config = Path("out/cells", cell, "config.json")
    config.write_text(config.read_text().replace('"episode_length": 20', '"episode_length": 30'))
    arguments = ("sweep", "tiny.toml", "--output", "out", "--max-parallel", 1)
    assert ailsrs(monkeypatch, *arguments) == 1
    said = capsys.readouterr()
    assert f"{cell} failed: cannot resume out/cells/{cell}: settings.episode_length" in said.err
    assert "1 of 2 cells failed; the same command tries them again" in said.err
    assert "1 of 2 cells done; table.md" in said.out
    assert ailsrs(monkeypatch, *arguments, "--quiet") == 1
    said = capsys.readouterr()
    assert said.out == ""
    assert "cannot resume" in said.err
    codes = {ailsrs(monkeypatch, *arguments, "--shard", f"{shard}/2") for shard in range(2)}
    assert codes == {0, 1}  # each shard answers for its own cells
    capsys.readouterr()
    assert ailsrs(monkeypatch, "merge", "merged", "out", "--json") == 1
    said = capsys.readouterr()
    assert said.err.endswith("1 of 2 cells failed\n")
    cells = json.loads(said.out)["cells"]
    assert [row["status"].partition(":")[0] for row in cells] == ["done", "failed"]


def test_what_is_finished_is_never_trained_again(in_tmp_path: Path) -> None:
    class Stop(Watch):
        def end(self, row: Any) -> None:
            raise KeyboardInterrupt

    spec = quick_grid(seeds=[0, 1, 2])
    with pytest.raises(KeyboardInterrupt):
        ail.sweep(spec, "sweep", watch=Stop())  # after evaluating the first of the stack
    resumed = Watch()
    rows = ail.sweep(spec, "sweep", watch=resumed)
    assert resumed.begun == [row["cell"] for row in rows[1:]]
    assert resumed.num_reports == 0

    for row in rows[1:]:
        Path("sweep/cells", row["cell"], "row.json").unlink()
    alone = Watch()
    assert ail.sweep(spec, "sweep", max_parallel=2, watch=alone) == rows
    assert (alone.begun, alone.num_reports) == (resumed.begun, 0)
