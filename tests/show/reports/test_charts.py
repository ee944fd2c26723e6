"""The geometry of charts."""

import re

import numpy as np
import pytest

from ailsrs_jax.show.reports.charts import HEIGHT, MOST_POINTS, Chart, Line, Panel, colors_of


def points(path: str) -> np.ndarray:
    return np.array(re.findall(r"(-?[\d.]+),(-?[\d.]+)", path), float)


def drawn(line: Line, **options: object) -> dict:
    panel = Panel("", "x", "y", [line], **options)
    return Chart("", [panel], {line.name: "red"}).drawn[0]


def test_points_are_where_the_axes_say() -> None:
    x, y = np.array([0.0, 1.0, 4.0]), np.array([-5.0, 20.0, 7.5])
    panel = drawn(Line("a", x, y), limits=(-10.0, None))
    left, top, right, bottom = panel["frame"]
    x0, x1, y0, y1 = panel["limits"]
    assert (y0, x0 < 0, x1 > 4, y1 > 20) == (-10.0, True, True, True)
    at = points(panel["lines"][0]["path"])
    assert x0 + (at[:, 0] - left) / (right - left) * (x1 - x0) == pytest.approx(x, abs=1e-4)
    assert y0 + (bottom - at[:, 1]) / (bottom - top) * (y1 - y0) == pytest.approx(y, abs=1e-3)
    ticks = {text: place for place, text in panel["x_ticks"]}
    assert ticks["1"] == pytest.approx(at[1, 0], abs=0.01)


def test_a_line_has_a_gap_where_nothing_was_measured() -> None:
    y = np.array([1.0, np.nan, 2.0, 3.0, np.nan])
    path = drawn(Line("a", np.arange(5.0), y))["lines"][0]["path"]
    assert re.sub(r"[^ML]", "", path) == "MML"


def test_an_area_goes_along_one_bound_and_back_along_the_other() -> None:
    low, high = np.array([0.0, 1.0, np.nan]), np.array([2.0, 4.0, np.nan])
    line = Line("a", np.arange(3.0), (low + high) / 2, band=(low, high))
    corners = points(drawn(line)["lines"][0]["area"])
    assert len(corners) == 4
    assert corners[0, 0] == corners[3, 0] < corners[1, 0] == corners[2, 0]
    assert corners[2, 1] < corners[3, 1] < corners[1, 1] < corners[0, 1] < HEIGHT


def test_long_lines_are_thinned_and_keep_their_ends() -> None:
    x = np.arange(5000.0)
    at = points(drawn(Line("a", x, x))["lines"][0]["path"])
    assert len(at) == MOST_POINTS
    few = points(drawn(Line("a", x[[0, -1]], x[[0, -1]]))["lines"][0]["path"])
    assert at[[0, -1]] == pytest.approx(few)


@pytest.mark.parametrize("y", [[], [np.nan], [3.0], [3.0, 3.0]])
def test_little_to_draw(y: list[float]) -> None:
    panel = drawn(Line("a", np.arange(float(len(y))), np.array(y)))
    assert np.isfinite(panel["limits"]).all()
    assert panel["limits"][0] < panel["limits"][1]
    assert panel["limits"][2] < panel["limits"][3]


def test_colours_are_distinct_and_begin_again() -> None:
    colors = colors_of([*"abcdefgh", "a"])
    assert len(set([*colors.values()][:7])) == 7
    assert colors["h"] == colors["a"]
