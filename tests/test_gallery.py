"""The gallery shows what the committed results hold."""

import re
from pathlib import Path

import pytest

import ailsrs_jax as ail

pytest.importorskip("experiments.gallery", reason="the package is installed without it")
from experiments.gallery import DOCS, medians

PAGE = DOCS / "gallery.md"
ROW = re.compile(r"^\| !\[(\w+)\]\((\S+)\) \| \1 \| (\S+) \| `(.*)` \| \[\S+\]\((\S+)\) \|$", re.M)
NAMES = ("search",)  # of the sweeps on the page


def test_the_gallery_shows_the_median_of_each_task() -> None:
    cells = [cell for name in NAMES for mine in medians(name).values() for cell in mine]
    rows = ROW.findall(PAGE.read_text())
    assert len(rows) == len(cells) > 0
    for cell, (_, film, score, command, policy) in zip(cells, rows, strict=True):
        assert score == f"{cell.normalized:.2f}"
        assert f"--seeds {cell.seed}" in command
        assert ail.load_policy(DOCS / policy).env_id == cell.env_id
        assert Path(DOCS, film).stat().st_size < 500_000
