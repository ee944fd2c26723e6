from pathlib import Path

import numpy as np
import pytest

from ailsrs_jax.errors import UserError
from ailsrs_jax.sweeps.results import read_results
from tests.sweeps.synthetic_sweep import row, write_sweep


def test_what_is_written_is_read(tmp_path: Path) -> None:
    rows = [
        row(0.95),
        row(0.1, label="ARS", num_trajectories=""),
        row(0.0, seed=2, status="failed: it diverged", return_mean="", normalized=""),
    ]
    results = read_results(write_sweep(tmp_path, rows))
    first, from_reward, failed = results.cells
    assert first.normalized == 0.95
    assert first.steps_to_90 == 500_000
    assert first.normalized_over_training == pytest.approx(0.57)
    assert (from_reward.num_trajectories, first.num_trajectories) == (None, 10)
    assert np.isnan([from_reward.steps_to_90, failed.return_mean]).all()
    assert results.done == [first, from_reward]
    assert results.curves.keys() == results.timings.keys() == {first.cell, from_reward.cell}
    curve = results.curves[first.cell]
    assert len(curve.returns) == 40
    assert curve.env_steps[-1] == 1_200_000
    assert results.timings[first.cell].seconds_to_90_percent == 25


@pytest.mark.parametrize(
    ("file", "old", "new", "message"),
    [
        ("results.csv", "return_mean", "returns", "results.csv has no column return_mean"),
        ("results.csv", "mujoco", "mujoco,1", r"results.csv, row 2: 27 fields, the header has 26"),
        ("results.csv", ",33,", ",many,", "row 2: kept_iteration is 'many', not a number"),
        ("results.csv", ",33,", ",,", "row 2: kept_iteration of a cell that is done is ''"),
        ("results.csv", ",33,", ",nan,", "row 2: kept_iteration of a cell that is done is 'nan'"),
        ("results.csv", ",,10,", ",,ten,", "row 2: num_trajectories is 'ten', not a number"),
        (
            "results.csv",
            ",10,,1,False,0,",
            ",10,,1,False,0.5,",
            "row 2: seed is '0.5', not a whole",
        ),
        ("results.csv", ",10,,1,False,0,", ",10,,1,False,,", "row 2: there is no seed"),
        ("results.csv", ",10,,1,False,0,", ",10,,1,no,0,", "row 2: states_only is 'no', not True"),
        ("results.csv", ",10,,1,False,0,", ",10,,,False,0,", "row 2: there is no subsample"),
        ("results.csv", "-10-1,", "-10-0,", "row 3: cell ailsrs-Hopper-v5-10-0 is there twice"),
        ("results.csv", "3240.0,18.0", "3240.0,", "random_return of a cell that is done is ''"),
        ("curves.csv", "evaluation_return", "r", "curves.csv has no column evaluation_return"),
        ("curves.csv", ",1,", ",x,", "curves.csv, row 3: iteration is 'x', not a number"),
        ("timings.csv", "hardware", "", "timings.csv has no column hardware"),
        ("timings.csv", "60.0", "soon", "timings.csv, row 2: train_seconds is 'soon', not a nu"),
    ],
)
def test_a_wrong_table_is_refused(
    tmp_path: Path, file: str, old: str, new: str, message: str
) -> None:
    write_sweep(tmp_path, [row(0.95), row(0.9, seed=1)])
    path = tmp_path / file
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(UserError, match=message):
        read_results(tmp_path)


@pytest.mark.parametrize("expert", ["", 18.0])  # there is none; it is no better than random
def test_without_an_expert_there_are_no_scores(tmp_path: Path, expert: object) -> None:
    rows = [row(0.5, num_trajectories="", expert_return=expert, normalized="", steps_to_90="")]
    (cell,) = read_results(write_sweep(tmp_path, rows)).cells
    assert cell.done
    assert np.isnan([cell.normalized, cell.normalized_over_training]).all()
    assert np.isnan(cell.normalize(np.zeros(3))).all()


@pytest.mark.parametrize("file", ["results.csv", "curves.csv", "timings.csv"])
def test_a_missing_or_empty_table_is_one_clear_line(tmp_path: Path, file: str) -> None:
    write_sweep(tmp_path, [row(0.95)])
    (tmp_path / file).write_text("")
    with pytest.raises(UserError, match=f"{file} is empty"):
        read_results(tmp_path)
    (tmp_path / file).unlink()
    with pytest.raises(UserError, match=f"no such file: .*{file}"):
        read_results(tmp_path)
