"""The curves of a sweep: every seed counts, and a series has one colour."""

from pathlib import Path

import numpy as np

from ailsrs_jax.show.reports.charts import colors_of
from ailsrs_jax.show.reports.curves import draw_numbers, draw_series, seeds
from ailsrs_jax.sweeps.results import read_results
from ailsrs_jax.sweeps.statistics import group_cells
from tests.sweeps.synthetic_sweep import row, write_sweep


def test_all_seeds_are_in_the_mean_and_in_the_area(tmp_path: Path) -> None:
    rows = [row(0.5, seed=seed, curve=[0.0, 0.1 * seed]) for seed in range(7)]
    rows += [row(0.9, label="BC", seed=seed, curve=[0.0, 1.0]) for seed in (3, 4)]
    results = read_results(write_sweep(tmp_path, rows))
    groups = group_cells(results.cells)
    colors = colors_of(group.series for group in groups)
    assert list(colors) == ["AILSRS", "BC"]
    chart = draw_series(groups, results, colors)
    assert chart is not None
    (panel,) = chart.panels
    assert [line.note for line in panel.lines] == ["7 seeds", "2 seeds"]
    line, reach = panel.lines[0], 3240.0 - 18.0
    assert line.band is not None
    ends = [(curve[-1] - 18.0) / reach for curve in (line.band[0], line.y, line.band[1])]
    np.testing.assert_allclose(ends, [0.0, 0.3, 0.6], atol=1e-6)
    assert panel.levels == {"expert": 3240.0, "random": 18.0}


def test_a_single_iteration_is_a_mark(tmp_path: Path) -> None:
    results = read_results(write_sweep(tmp_path, [row(0.9, iterations=1)]))
    groups = group_cells(results.cells)
    chart = draw_series(groups, results, colors_of(group.series for group in groups))
    assert chart is not None
    assert [line.look for line in chart.panels[0].lines] == ["marks"]


def test_curves_are_those_with_the_most_demonstrations(tmp_path: Path) -> None:
    rows = [row(number / 40, num_trajectories=number, seed=1) for number in (40, 10)]
    results = read_results(write_sweep(tmp_path, rows))
    groups = group_cells(results.cells)
    colors = colors_of(group.series for group in groups)
    chart = draw_series(groups, results, colors)
    assert chart is not None
    (line,) = chart.panels[0].lines
    assert line.y[-1] == results.curves["ailsrs-Hopper-v5-40-1"].returns[-1]
    numbers = draw_numbers(groups, colors)
    assert numbers is not None
    (line,) = numbers.panels[0].lines
    np.testing.assert_allclose(line.x, [10, 40])
    np.testing.assert_allclose(line.y, [18 + 0.25 * 3222, 3240])
    assert draw_numbers(groups[:1], colors) is None


def test_numbers_of_seeds() -> None:
    assert [seeds(1), seeds(3, 3), seeds(10, 2)] == ["1 seed", "3 seeds", "2 to 10 seeds"]
