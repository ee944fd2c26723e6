"""Sweeps that several processes train: shards, merging, and one directory for all."""

import dataclasses
import shutil
from pathlib import Path
from typing import Any

import pytest

import ailsrs_jax as ail
from ailsrs_jax import files
from ailsrs_jax.errors import InUseError
from ailsrs_jax.files import write_json
from ailsrs_jax.runs.storage.directory import claimed, locked
from ailsrs_jax.sweeps.cells import Sweep
from ailsrs_jax.sweeps.merge import merge_sweeps
from ailsrs_jax.sweeps.spec import expand
from ailsrs_jax.sweeps.stacks import begun_stacks, stack_directory
from ailsrs_jax.sweeps.sweep import choose_units, run_units
from ailsrs_jax.sweeps.tables import failed_row, load_row, save_row
from tests.sweeps.toy_sweep import Watch, quick_grid, two_cells


def test_shards_are_the_whole(in_tmp_path: Path, one_by_one: tuple[Path, list[Any]]) -> None:
    settings = {"noise_std": [0.1, 0.2]}
    cells = expand(quick_grid(seeds=[0, 1, 2, 3], settings=settings))
    whole = choose_units(cells, (0, 1), 3)
    assert [len(unit) for unit in whole] == [3, 3, 2]
    shards = [choose_units(cells, (index, 2), 3) for index in range(2)]
    assert sorted([*shards[0], *shards[1]], key=whole.index) == whole
    assert [sum(map(len, shard)) for shard in shards] == [5, 3]
    assert choose_units(cells, (3, 4), 3) == []
    for shard in ((2, 2), (-1, 2), (0, 0), (0, 10**15)):
        with pytest.raises(ail.UserError, match="write I/N"):
            choose_units(cells, shard, 3)
    with pytest.raises(ail.UserError, match="max_parallel is 0"):
        choose_units(cells, (0, 1), 0)

    arguments: dict[str, Any] = {"max_parallel": 1}
    spec = two_cells()
    for index in range(2):
        ail.sweep(spec, f"part-{index}", shard=(index, 2), **arguments)
    half = merge_sweeps(Path("merged"), [Path("part-0")])
    assert sorted(row["status"] for row in half) == ["done", "not run"]
    rows = merge_sweeps(Path("merged"), [Path("part-0"), Path("part-1")])
    for name in ("results.csv", "curves.csv"):
        assert Path("merged", name).read_bytes() == (one_by_one[0] / name).read_bytes()
    again = Watch()
    assert ail.sweep(spec, "merged", watch=again, **arguments) == rows
    assert again.begun == []

    expand(quick_grid()).save(Path("other/sweep.json"))
    with pytest.raises(ail.UserError, match="other holds another sweep"):
        merge_sweeps(Path("merged"), [Path("part-0"), Path("other")])
    with pytest.raises(ail.UserError, match="no such file"):
        merge_sweeps(Path("merged"), [Path("nowhere")])


def test_merging_loses_nothing_and_copies_files_only(
    in_tmp_path: Path, one_by_one: tuple[Path, list[Any]]
) -> None:
    spec = two_cells()
    shutil.copytree(one_by_one[0], "shard")
    cell = expand(spec).cells[0]
    theirs, ours = (Path(sweep, "cells", cell.name) for sweep in ("shard", "merged"))
    done = (theirs / "row.json").read_text()
    save_row(theirs, failed_row(cell, "no space"), None)
    with pytest.raises(KeyboardInterrupt):
        ail.sweep(spec, "merged", max_parallel=1, watch=Watch(KeyboardInterrupt(), at=11))
    metrics = (ours / "metrics.csv").read_bytes()
    merge_sweeps("merged", ["shard"])
    assert (ours / "metrics.csv").read_bytes() == metrics
    assert (ours / "checkpoints" / "10").exists()

    (theirs / "row.json").write_text(done)
    (theirs / "more").symlink_to("/dev/zero")
    with pytest.raises(ail.UserError, match="more is neither a file nor a directory"):
        merge_sweeps("merged", ["shard"])
    (theirs / "more").unlink()
    with locked(ours), pytest.raises(InUseError, match="another process is writing to merged"):
        merge_sweeps("merged", ["shard"])
    assert (ours / "metrics.csv").read_bytes() == metrics
    assert merge_sweeps("merged", ["shard"]) == one_by_one[1]


def test_a_stack_is_finished_before_anything_is_merged_into_it(
    in_tmp_path: Path, one_by_one: tuple[Path, list[Any]]
) -> None:
    spec = two_cells()
    with pytest.raises(KeyboardInterrupt):
        ail.sweep(spec, "merged", watch=Watch(KeyboardInterrupt(), at=11))
    with pytest.raises(ail.UserError, match="let them finish, or delete it"):
        merge_sweeps("merged", [one_by_one[0]])
    rows = ail.sweep(spec, "merged")
    assert merge_sweeps("merged", [one_by_one[0]]) == rows


def test_files_may_go_while_they_are_read(
    in_tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A process ends a stack, or begins a failed cell again, while another one looks at it."""
    cell = expand(two_cells()).cells[0]
    directory, stack = Path("cells", cell.name), Path("stacks", "1")
    write_json(stack / "cells.json", {"cells": [cell.name]})
    (stack / "checkpoints" / "10").mkdir(parents=True)
    save_row(directory, failed_row(cell, "no space"), None)
    assert begun_stacks(Path(), {cell.name}) == [stack]
    assert load_row(directory)[0]["status"] == "failed: no space"
    with monkeypatch.context() as patched:
        reading = files.require_file

        def gone(path: Path) -> None:
            path.unlink()
            reading(path)

        patched.setattr(files, "require_file", gone)
        assert begun_stacks(Path(), {cell.name}) == []
        assert load_row(directory) == ({}, None)
    with monkeypatch.context() as patched:

        def emptied(path: Path, pattern: str) -> Any:
            if path == stack:
                raise FileNotFoundError(path)
            return [stack]

        patched.setattr(Path, "glob", emptied)
        assert begun_stacks(Path(), {cell.name}) == []


def test_what_another_process_trains_is_left_to_it(in_tmp_path: Path) -> None:
    spec = quick_grid(seeds=[0, 1])
    cells = expand(spec).cells
    units = choose_units(expand(spec), (0, 1), 1)
    directory = Path("sweep", "cells", cells[0].name)
    watch = Watch()
    config = cells[0].make_plan().config
    with claimed(directory, config, resume=False):
        with pytest.raises(InUseError), claimed(directory, config, resume=False):
            pass  # a process that looked before config.json was written
        rows = ail.sweep(spec, "sweep", max_parallel=1, watch=watch)
    assert [row["status"] for row in rows] == ["not run", "done"]
    assert "another process is writing to" in watch.rows[0]["status"]
    assert not (directory / "row.json").exists()

    again = Watch()  # of a process that finds its units finished meanwhile
    run_units(expand(spec), units[1:], Path("sweep"), watch=again)
    assert (again.begun, again.rows) == ([], [])


def test_a_stack_is_left_to_another_process_until_its_rows_are_saved(in_tmp_path: Path) -> None:
    grid = expand(two_cells())
    (unit,) = choose_units(grid, (0, 1), 2)
    watch = Watch()
    with locked(stack_directory(Path("sweep"), unit)):
        rows = ail.sweep(two_cells(), "sweep", watch=watch)
    assert [row["status"] for row in rows] == ["not run", "not run"]
    assert all("another process is writing to" in row["status"] for row in watch.rows)
    assert [row["status"] for row in ail.sweep(two_cells(), "sweep")] == ["done", "done"]


def test_what_uses_all_cores_is_trained_alone(in_tmp_path: Path) -> None:
    (engine,) = {cell.engine for cell in expand(two_cells()).cells}
    for name, num_units in {engine: 1, "mujoco": 2, "gymnasium": 2}.items():
        cells = [dataclasses.replace(cell, engine=name) for cell in expand(two_cells()).cells]
        assert len(choose_units(Sweep(tuple(cells), 2), (0, 1), 64)) == num_units
