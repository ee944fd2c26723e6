import itertools

import numpy as np
import pytest
from scipy import stats

from ailsrs_jax.sweeps import statistics
from ailsrs_jax.sweeps.results import Curve
from tests.sweeps.synthetic_sweep import cells, row


def test_probability_of_improvement_counts_pairs_in_each_condition() -> None:
    better, worse = np.array([3.0, 4.0]), np.array([1.0, 2.0, 0.0])
    even = np.array([1.0, 2.0]), np.array([1.0, 2.0])
    estimate = statistics.probability_of_improvement([(better, worse), even])
    assert estimate.value == pytest.approx((1.0 + 0.5) / 2)
    assert estimate.low <= estimate.value <= estimate.high
    mirrored = statistics.probability_of_improvement([(worse, better), even])
    assert mirrored.value == pytest.approx(1 - estimate.value)
    # SciPy's U counts the same pairs.
    x, y = np.random.default_rng(0).normal(size=(2, 9))
    counted = stats.mannwhitneyu(x, y).statistic / (len(x) * len(y))
    assert statistics.probability_of_improvement([(x, y)]).value == pytest.approx(counted)


def test_interquartile_mean_is_the_mean_of_the_middle_half_of_all_strata() -> None:
    strata = [np.array([100.0, 2.0, -50.0, 4.0]), np.array([3.0, 5.0, 1.0, 9.0])]
    # Sorted: -50 1 | 2 3 4 5 | 9 100.
    assert statistics.interquartile_mean(strata).value == 3.5


def test_interval_is_that_of_all_equally_likely_draws() -> None:
    strata = [np.array([0.1, 0.5, 0.6]), np.array([0.9, 1.0, 0.2])]
    draws = itertools.product(*(itertools.product(stratum, repeat=3) for stratum in strata))
    means = np.array([np.concatenate(draw).mean() for draw in draws])  # 27 × 27 of them
    interval = statistics.bootstrap(strata, lambda scores: scores.mean(axis=-1))
    assert interval.value == pytest.approx(0.55)
    # As percentiles they are within sampling error, the width of which is 0.2 percentage points.
    assert 0.015 < (means <= interval.low).mean() < 0.035
    assert 0.015 < (means >= interval.high).mean() < 0.035


def test_strata_keep_their_weight() -> None:
    # Drawn from both at once, the mean of two runs would be 0, 1/2 or 1.
    interval = statistics.bootstrap([np.zeros(3), np.ones(3)], lambda s: s.mean(axis=-1))
    assert (interval.low, interval.value, interval.high) == (0.5, 0.5, 0.5)


def test_the_interval_covers_and_is_the_same_again() -> None:
    generator = np.random.default_rng(0)
    covered = 0
    for _ in range(60):
        strata = [task + generator.standard_normal(10) for task in (0.0, 1.0, 2.0)]
        interval = statistics.bootstrap(strata, lambda scores: scores.mean(axis=-1))
        covered += interval.low < 1 < interval.high
    assert 52 <= covered <= 60
    assert statistics.interquartile_mean(strata) == statistics.interquartile_mean(strata)


def test_one_seed_has_no_interval() -> None:
    estimate = statistics.interquartile_mean([np.array([0.7]), np.array([0.1, 0.2])])
    assert np.isfinite(estimate.value)
    assert np.isnan([estimate.low, estimate.high]).all()
    profile = statistics.performance_profile([np.array([0.7])])
    assert profile.low.shape == profile.value.shape


def test_performance_profile_counts_the_runs_above() -> None:
    strata = [np.array([0.105, 0.505]), np.array([0.505, 1.005])]
    profile = statistics.performance_profile(strata)
    at = {0.0: 1.0, 0.2: 0.75, 0.6: 0.25, 1.1: 0.0}
    for threshold, share in at.items():
        index = np.abs(statistics.THRESHOLDS - threshold).argmin()
        assert profile.value[index] == share
    assert (profile.low <= profile.value).all()
    assert (profile.value <= profile.high).all()
    # Both seeds of the first task below 0.2: one draw in four, so it is inside the interval.
    index = np.abs(statistics.THRESHOLDS - 0.2).argmin()
    assert (profile.low[index], profile.high[index]) == (0.5, 1.0)


def test_never_is_later_than_any_time() -> None:
    never = np.nan
    assert statistics.median_reached(np.array([3.0, never, 1.0])) == (3.0, 2)
    assert statistics.median_reached(np.array([3.0, never, never])) == (np.inf, 1)
    assert statistics.median_reached(np.array([1.0, 3.0, never, never])) == (np.inf, 2)
    assert statistics.median_reached(np.array([5.0, 1.0, 4.0])) == (4.0, 3)


def test_mean_and_standard_deviation_are_the_samples() -> None:
    assert statistics.mean_std(np.array([1.0, 2.0, 3.0])) == (2.0, 1.0)
    mean, std = statistics.mean_std(np.array([4.0]))
    assert mean == 4
    assert np.isnan(std)


def test_smoothing_keeps_constants_and_spreads_a_peak_like_a_gaussian() -> None:
    np.testing.assert_allclose(statistics.smoothed(np.full(30, 5.0)), 5)
    peak = statistics.smoothed(np.eye(1, 401, 200)[0])  # 401 / 50 iterations wide
    assert peak.sum() == pytest.approx(1)
    variance = (peak * (np.arange(401) - 200) ** 2).sum()
    assert np.sqrt(variance) == pytest.approx(401 / 50, rel=1e-2)


def test_the_mean_curve_ends_with_the_shortest() -> None:
    long = Curve(np.arange(3.0), np.array([10.0, 20, 30]), np.array([1.0, 2, 3]))
    short = Curve(np.arange(2.0), np.array([20.0, 40]), np.array([3.0, 6]))
    mean = statistics.mean_curve([long, short])
    np.testing.assert_array_equal(mean.env_steps, [15, 30])
    np.testing.assert_array_equal(mean.returns, [2, 4])


def test_an_evaluation_that_diverged_leaves_the_mean_to_the_others() -> None:
    never = np.nan
    curves = [
        Curve(np.arange(3.0), np.arange(3.0), np.array(returns))
        for returns in ([1.0, never, never], [3.0, 6.0, never])
    ]
    np.testing.assert_array_equal(statistics.mean_curve(curves).returns, [2, 6, never])


def test_a_group_is_a_series_on_a_task_and_leaves_out_what_failed() -> None:
    table = cells(
        row(1.0, seed=0),
        row(0.5, seed=1),
        row(0.2, seed=2, status="failed: it diverged"),
        row(0.3, num_trajectories=20),
        row(0.3, label="BC", status="failed: no demonstrations"),
    )
    first, second = statistics.group_cells(table)
    assert (first.series, first.condition, first.num_planned) == ("AILSRS", ("Hopper-v5", 10), 3)
    np.testing.assert_array_equal(first.values("normalized"), [1, 0.5])
    assert second.condition == ("Hopper-v5", 20)


def test_series_are_told_apart_only_where_they_meet() -> None:
    table = cells(
        row(1, cell="a", env_id="Hopper-v5"),
        row(1, cell="b", env_id="Swimmer-v5", preset="paper"),
        row(1, cell="c", label="GAIL", settings="x=1;y=2"),
        row(1, cell="d", label="GAIL", settings=""),
        row(1, cell="e", label="GAIL", settings="", env_id="Swimmer-v5"),
        row(1, cell="f", label="BC"),
        row(1, cell="g", label="BC", subsample=20),
        row(1, cell="h", label="BC", demonstrations="mine.npz"),
        row(1, cell="i", label="ours", algorithm="bc"),
        row(1, cell="j", label="ours", algorithm="gail"),
        row(1, cell="k", label="theirs", algorithm="ailsrs"),
        row(1, cell="l", label="theirs", algorithm="ars", num_trajectories=""),
        row(1, cell="m", label="drawn"),
        row(1, cell="n", label="drawn", draw_from=40),
        row(1, cell="o", label="seen"),
        row(1, cell="p", label="seen", states_only=True),
    )
    assert statistics.series_names(table) == {
        "a": "AILSRS",
        "b": "AILSRS",
        "c": "GAIL (x=1, y=2)",
        "d": "GAIL (as preset)",
        "e": "GAIL (as preset)",
        "f": "BC (shipped expert, subsample=1)",
        "g": "BC (shipped expert, subsample=20)",
        "h": "BC (mine.npz, subsample=1)",
        "i": "ours (bc)",
        "j": "ours (gail)",
        "k": "theirs (ailsrs)",
        "l": "theirs (ars)",
        "m": "drawn (the first)",
        "n": "drawn (drawn from 40)",
        "o": "seen (with actions)",
        "p": "seen (states alone)",
    }


def test_only_what_all_have_been_measured_on_is_compared() -> None:
    table = cells(
        *(row(1, num_trajectories=number) for number in (10, 20)),
        row(1, env_id="Swimmer-v5"),
        row(1, label="BC", num_trajectories=10),
        row(1, label="BC", num_trajectories=30),
        row(1, label="ARS", num_trajectories=""),
    )
    common = statistics.comparable(statistics.group_cells(table))
    assert {series: [g.condition for g in mine] for series, mine in common.items()} == {
        "AILSRS": [("Hopper-v5", 10)],
        "BC": [("Hopper-v5", 10)],
        "ARS": [("Hopper-v5", None)],
    }


def test_conditions_are_shared_by_all_series_at_once() -> None:
    """Hopper was measured by all three, but never with the same number of demonstrations."""
    groups = statistics.group_cells(
        cells(
            row(1, num_trajectories=10),
            row(1, env_id="Swimmer-v5", num_trajectories=10),
            row(1, label="GAIL", num_trajectories=40),
            row(1, label="GAIL", env_id="Swimmer-v5", num_trajectories=10),
            row(1, label="ARS", num_trajectories=""),
            row(1, label="ARS", env_id="Swimmer-v5", num_trajectories=""),
        )
    )
    common = statistics.comparable(groups)
    assert {group.env_id for mine in common.values() for group in mine} == {"Swimmer-v5"}
    assert statistics.shared_conditions(groups) == {("Swimmer-v5", 10)}  # for ARS, too


def test_a_series_without_demonstrations_is_compared_with_any() -> None:
    imitates, other, learns = statistics.group_cells(
        cells(
            row(1, num_trajectories=10),
            row(0.5, num_trajectories=20),
            row(0.8, label="ARS", num_trajectories=""),
        )
    )
    pairs = statistics.shared_scores([imitates, other], [learns])
    np.testing.assert_allclose(pairs, [([1.0], [0.8]), ([0.5], [0.8])])
    np.testing.assert_allclose(statistics.shared_scores([learns], [other]), [([0.8], [0.5])])


def test_scores_leave_out_what_was_not_measured() -> None:
    groups = statistics.group_cells(
        cells(row(1.0), row(0.5, seed=1, mean_return_over_training=np.nan))
    )
    np.testing.assert_allclose(statistics.scores(groups, "normalized_over_training"), [[0.6]])
    np.testing.assert_allclose(statistics.scores(groups), [[1, 0.5]])
