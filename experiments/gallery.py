"""Write docs/gallery.md: the median policy of each task, with its film, score and command.

usage: python -m experiments.gallery NAME=DIRECTORY...

NAME is that of a sweep of AILSRS whose results are committed, and DIRECTORY where it ran.
"""

import json
import shutil
import sys
from pathlib import Path

from ailsrs_jax.show.sweep_report import markdown_table
from ailsrs_jax.show.video import render
from ailsrs_jax.sweeps.results import CellResult, read_results
from ailsrs_jax.sweeps.statistics import group_cells
from experiments.results import RESULTS
from experiments.rules import short

DOCS = Path(__file__).parents[1] / "docs"
FILMS = DOCS / "gallery"
SECONDS, SIZE = 4.0, 160
INTRODUCTION = """\
# Gallery

AILSRS trained these policies with the preset `tuned`. They are linear, and Humanoid's is a network.
Of each task this page shows the seed with the median score. On the left is the expert, a neural
network, and on the right the policy, from the same initial state. The films are in real time. A
score of 0 is a random policy and 1 is the expert. The scores are of 100 episodes in Gymnasium, from
the tables of the [results](../experiments/RESULTS.md).

A policy is a small file: `ail.load_policy("hopper.npz")` needs only NumPy to act. On the site that
`make docs` builds where `npm` is installed, you can <a href="play.html">push Hopper yourself</a>.

`python -m experiments.gallery` wrote this page and its files. A command gives the same policy on
the same processor and with the same versions, else [one that is about as
good](numerics.md#what-is-reproducible)."""


def main() -> None:
    """Write the page and its files."""
    shutil.rmtree(FILMS, ignore_errors=True)
    FILMS.mkdir()
    parts = [INTRODUCTION]
    for name, directory in (argument.split("=", 1) for argument in sys.argv[1:]):
        for label, cells in medians(name).items():
            rows = [_show(cell, Path(directory) / "cells" / cell.cell) for cell in cells]
            header = ["expert and policy", "task", "score", "command", "policy"]
            parts += [f"## {label[:1].upper()}{label[1:]}", markdown_table(header, rows)]
    (DOCS / "gallery.md").write_text("\n\n".join(parts) + "\n")


def medians(name: str) -> dict[str, list[CellResult]]:
    """Return for each label of AILSRS in the committed sweep the median cell of each task."""
    found: dict[str, list[CellResult]] = {}
    for group in group_cells(read_results(RESULTS / name).cells):
        cells = sorted(group.cells, key=lambda cell: cell.normalized)
        if cells[0].algorithm == "ailsrs":
            found.setdefault(cells[0].label, []).append(cells[len(cells) // 2])
    return found


def _show(cell: CellResult, run: Path) -> list[str]:
    """Copy the policy of a cell, film it, and return the cell's row of the page."""
    stem = "-".join([short(cell.env_id), *cell.label.replace(",", "").split()[:2]]).lower()
    policy, film = FILMS / f"{stem}.npz", FILMS / f"{stem}.webp"
    shutil.copyfile(run / f"seed_{cell.seed}" / "policy.npz", policy)
    render(policy, film, seconds=SECONDS, size=SIZE)
    command = json.loads((run / "result.json").read_text())["command"]
    return [
        f"![{short(cell.env_id)}](gallery/{film.name})",
        short(cell.env_id),
        f"{cell.normalized:.2f}",
        f"`{command}`",
        f"[{policy.name}](gallery/{policy.name})",
    ]


if __name__ == "__main__":
    main()
