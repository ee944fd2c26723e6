"""The pages of ``ailsrs report`` in a real browser."""

import dataclasses
import json
import re
from fractions import Fraction
from html import unescape
from pathlib import Path

import numpy as np
import pytest

from ailsrs_jax.show.reports.charts import Chart, Line, Panel
from ailsrs_jax.show.reports.page import Media, Page, Tile
from ailsrs_jax.show.reports.weights import WeightMaps
from ailsrs_jax.show.sweep_report import Table
from ailsrs_jax.show.video import data_uri, encode
from tests.show.browser import BROWSER, open_in_browser
from tests.show.reports.test_report import HOSTILE, Reader, require_harmless


def hostile_page() -> Page:
    """A page with a part of each kind, and a name that would do harm in each place."""
    film = encode(np.zeros((3, 16, 16, 3), np.uint8), Fraction(10))
    line = Line(HOSTILE, np.array([0.0, 1, 2]), np.array([10.0, 30, 20]), note=HOSTILE)
    other = dataclasses.replace(line, name="other", y=np.array([0.0, 1, 2]), note="")
    panel = Panel(HOSTILE, HOSTILE, HOSTILE, [line, other], {HOSTILE: 5.0})
    return Page(
        kind="run",
        title=HOSTILE,
        subtitle=HOSTILE,
        tiles=[Tile(HOSTILE, HOSTILE)],
        parts=[
            Chart(HOSTILE, [panel], {HOSTILE: "red", "other": "blue"}, HOSTILE),
            Table(HOSTILE, [HOSTILE], [[HOSTILE]], HOSTILE),
            WeightMaps(HOSTILE, {HOSTILE: [(HOSTILE, [1.0])]}, [HOSTILE], 1.0, HOSTILE),
            Media("video", data_uri("video/mp4", film), HOSTILE),
            Media(HOSTILE, None, HOSTILE),
        ],
        note=HOSTILE,
        commands=[HOSTILE, HOSTILE],
        settings={HOSTILE: HOSTILE},
        changed={HOSTILE},
        versions={HOSTILE: HOSTILE},
    )


@pytest.mark.skipif(BROWSER is None, reason="no chromium: apt-get install chromium")
def test_a_browser_has_nothing_to_complain_of_and_asks_for_nothing(tmp_path: Path) -> None:
    (tmp_path / "page.html").write_text(hostile_page().html())
    require_harmless(Reader(tmp_path / "page.html"))
    document, console, asked = open_in_browser(tmp_path / "page.html", tmp_path / "log.json")
    assert "</html>" in document
    (tmp_path / "seen.html").write_text(document)
    require_harmless(Reader(tmp_path / "seen.html"))
    assert (console, asked) == ([], [])

    # And it would have been heard.
    bad = "<script>console.error('heard')</script><img src='http://127.0.0.1:9/picture'>"
    (tmp_path / "bad.html").write_text(bad)
    _, console, asked = open_in_browser(tmp_path / "bad.html", tmp_path / "bad.json")
    assert any("heard" in line for line in console)
    assert "http://127.0.0.1:9/picture" in asked


MOUSE = """<script>
const svg = document.querySelector(".panel svg"), box = svg.getBoundingClientRect();
function move() {
  const at = { clientX: box.left + box.width / 2, clientY: box.top + 20 };
  svg.dispatchEvent(new PointerEvent("pointermove", at));
  const rows = [...document.querySelectorAll(".tip div")].map((row) => row.textContent);
  document.body.append(JSON.stringify(rows), ";");
}
move();
document.querySelector(".legend button").click();
move();
svg.dispatchEvent(new PointerEvent("pointerleave"));
document.body.append(document.querySelector(".tip").hidden);
</script>"""


@pytest.mark.skipif(BROWSER is None, reason="no chromium: apt-get install chromium")
def test_curves_answer_the_mouse(tmp_path: Path) -> None:
    """The value under the cursor is shown; a click on the legend hides a series."""
    html = re.sub("script-src '[^']*'", "script-src 'unsafe-inline'", hostile_page().html())
    (tmp_path / "page.html").write_text(html.replace("</body>", f"{MOUSE}</body>"))
    document, console, _ = open_in_browser(tmp_path / "page.html", tmp_path / "log.json")
    assert console == []
    told = unescape(document.rpartition("</script>")[2].partition("</body>")[0])
    both, one, is_hidden = told.split(";")
    assert json.loads(both) == [f"{HOSTILE} 1", f"{HOSTILE}, {HOSTILE}: 30", "other: 1"]
    assert json.loads(one) == [f"{HOSTILE} 1", "other: 1"]
    assert is_hidden.strip() == "true"
