"""The look that all figures share: colours, lines, panels and the legend."""

import io
from collections.abc import Sequence
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

WIDTH = 7.16  # [in] of a page with two columns
STYLE = "ailsrs_jax.show.figures"  # figures.mplstyle
# The palette of Okabe and Ito without yellow, and without black, which the expert has.
COLORS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#7F7F7F")
# Markers and line styles differ as well, so that series stay distinct in black and white.
MARKERS = ("o", "s", "^", "D", "v", "P", "X", "*")
LINES = ("-", (0, (5, 1.5)), (0, (3, 1, 1, 1)), (0, (1.5, 1)))
EXPERT: dict[str, Any] = {"color": "black", "linestyle": (0, (6, 3)), "linewidth": 0.9, "zorder": 1}
RANDOM: dict[str, Any] = {"color": "0.45", "linestyle": (0, (1, 2)), "linewidth": 1.1, "zorder": 1}


def panels(
    names: Sequence[str], most_columns: int, row_height: float, width: float = WIDTH
) -> tuple[Figure, dict[str, Axes]]:
    """Return a figure of that ``width`` [in] and its axes by name, in rows of ``row_height``."""
    num_columns = min(len(names), most_columns)
    num_rows = -(-len(names) // num_columns)
    figure = Figure((width, 0.5 + row_height * num_rows), layout="constrained")
    axes = figure.subplots(num_rows, num_columns, squeeze=False).flat
    for unused in axes[len(names) :]:
        unused.remove()
    return figure, dict(zip(names, axes))


def legend_label(name: str) -> str:
    """Return ``name`` so that Matplotlib shows it, also if it begins with an underscore."""
    return f"\N{ZERO WIDTH SPACE}{name}" if name.startswith("_") else name


def add_legend(figure: Figure, title: str | None = None) -> None:
    """Add one legend above all panels, with each label once."""
    handles: dict[str, Any] = {}
    for axes in figure.axes:
        for handle, label in zip(*axes.get_legend_handles_labels()):
            handles.setdefault(label, handle)
    longest = 0.7 + 0.065 * max(map(len, handles))  # [in] of a column, with its line
    num_columns = min(max(int(figure.get_figwidth() / longest), 1), len(handles))
    num_rows = -(-len(handles) // num_columns)
    figure.set_figheight(figure.get_figheight() + 0.17 * (num_rows - 1))
    figure.legend(
        list(handles.values()),
        list(handles),
        loc="outside upper center",
        ncols=num_columns,
        title=title,
    )


def encoded(figure: Figure, kind: str, **options: Any) -> bytes:
    """Return the figure as a file of that ``kind``, the same bytes for the same figure."""
    undated: dict[str, Any] = {"pdf": {"CreationDate": None}, "svg": {"Date": None}}
    file = io.BytesIO()
    figure.savefig(file, format=kind, metadata=undated.get(kind), **options)
    return file.getvalue()
