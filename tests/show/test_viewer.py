"""What is added to the page of Brax's viewer, in a real browser."""

import re
from pathlib import Path
from urllib.parse import quote

import pytest

from ailsrs_jax.show.episodes.viewer import viewer_html
from tests.show.browser import BROWSER, open_in_browser
from tests.show.test_video import made_up

# In place of what the page loads from the internet: a viewer that draws nothing.
VIEWER = """
class Vector { clone() { return new Vector(); } }
for (const name of ['copy', 'set', 'add', 'sub', 'setZ', 'project'])
  Vector.prototype[name] = function () { Object.assign(this, {x: 0.5, y: 0.5}); return this; };
export class Viewer {
  constructor() {
    this.target = {position: new Vector()};
    this.camera = {position: new Vector(), follow: true};
    this.controls = {target: new Vector()};
    this.scene = {getObjectByName: (name) => name === 'policy_cart' ? this.target : null};
    this.animate();
  }
  animate() {}
}
"""
SCENE = '{"size": 1, "labels": {"policy": "policy_cart"}}'
PAKO = f"<script>var pako = {{inflate: () => new TextEncoder().encode('{SCENE}')}}</script>"


@pytest.mark.skipif(BROWSER is None, reason="no chromium: apt-get install chromium")
@pytest.mark.parametrize("is_there", [True, False])
def test_the_words_leave_and_labels_come_with_the_viewer(is_there: bool, tmp_path: Path) -> None:
    html = viewer_html([made_up(3)], ["policy"])
    viewer = quote(VIEWER if is_there else "throw new Error('not there')")
    html, found = re.subn(r'"viewer": "[^"]+"', f'"viewer": "data:text/javascript,{viewer}"', html)
    html, also = re.subn(r"<script src=.*pako.*</script>", PAKO, html)
    assert (found, also) == (1, 1)
    html = re.sub(r"<script async.*</script>", "", html)
    (tmp_path / "page.html").write_text(html)
    document, _, asked = open_in_browser(tmp_path / "page.html", tmp_path / "log.json")
    label = '<div class="label" style="left: 75%; top: 25%;">policy</div>'
    assert ("it loads the viewer from the internet" in document) == (not is_there)
    assert (label in document) == is_there
    assert not asked
