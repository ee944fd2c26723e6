"""Line charts of a page, as SVG that the template draws and ``page.js`` makes answer the mouse."""

import dataclasses
import itertools
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.ticker import MaxNLocator

from ailsrs_jax.show.style import COLORS

MOST_POINTS = 600  # of a line; more cannot be told apart on a screen
WIDE, NARROW, HEIGHT = 540, 360, 250  # of a panel [px]
FAR, HUGE = 1e6, 1e30  # places [px] and numbers that nobody draws
LEFT, TOP, RIGHT, BOTTOM = 58, 10, 14, 42  # around the axes [px]


@dataclasses.dataclass(frozen=True)
class Line:
    """Points of a series. Lines of one name have one colour, and the legend hides them together."""

    name: str
    x: np.ndarray
    y: np.ndarray  # NaN leaves a gap
    look: str = "line"  # or dashed, marks, cloud
    band: tuple[np.ndarray, np.ndarray] | None = None  # the area between two curves
    note: str = ""  # beside its values


@dataclasses.dataclass(frozen=True)
class Panel:
    """Lines with common axes."""

    title: str
    x_label: str
    y_label: str
    lines: Sequence[Line]
    levels: Mapping[str, float] = dataclasses.field(default_factory=dict)  # horizontal, by name
    limits: tuple[float | None, float | None] = (None, None)  # of y


@dataclasses.dataclass(frozen=True)
class Chart:
    """Panels with a common legend; ``colors`` has every name in the order of the legend."""

    title: str
    panels: Sequence[Panel]
    colors: Mapping[str, str]
    caption: str = ""

    @property
    def drawn(self) -> list[dict[str, Any]]:
        """What the template needs of each panel."""
        width = WIDE if len(self.panels) in (1, 2, 4) else NARROW
        return [_drawn(panel, width) for panel in self.panels]


def colors_of(names: Iterable[str]) -> dict[str, str]:
    """Return a colour for each name."""
    return dict(zip(dict.fromkeys(names), itertools.cycle(COLORS)))


def _drawn(panel: Panel, width: int) -> dict[str, Any]:
    bands = [bound for line in panel.lines for bound in line.band or ()]
    x_limits = _limits([line.x for line in panel.lines])
    levels = {name: level for name, level in panel.levels.items() if np.isfinite(level)}
    ys = [*(line.y for line in panel.lines), *bands, np.array([*levels.values()])]
    y_limits = _limits(ys, *panel.limits)
    left, top, right, bottom = frame = LEFT, TOP, width - RIGHT, HEIGHT - BOTTOM

    def at_x(x: Any) -> Any:
        return left + (x - x_limits[0]) / (x_limits[1] - x_limits[0]) * (right - left)

    def at_y(y: Any) -> Any:
        return bottom - (y - y_limits[0]) / (y_limits[1] - y_limits[0]) * (bottom - top)

    def drawn(line: Line) -> dict[str, Any]:
        few = np.arange(len(line.x))
        if line.look in ("line", "dashed") and len(few) > MOST_POINTS:
            few = np.linspace(0, len(few) - 1, MOST_POINTS).round().astype(int)
        x, area = at_x(line.x[few]), ""
        if line.band is not None:
            low, high = (at_y(bound[few]) for bound in line.band)
            there = np.isfinite(low) & np.isfinite(high)
            edge = np.concatenate([low[there], high[there][::-1]])
            area = _path(np.concatenate([x[there], x[there][::-1]]), edge)
        path = _path(x, at_y(line.y[few]), apart=line.look in ("marks", "cloud"))
        return vars(line) | {"path": path, "area": area}

    return {
        "panel": panel,
        "size": (width, HEIGHT),
        "frame": frame,
        "limits": (*x_limits, *y_limits),
        "x_ticks": [(at_x(tick), f"{tick:g}") for tick in _ticks(x_limits, width // 90)],
        "y_ticks": [(at_y(tick), f"{tick:g}") for tick in _ticks(y_limits, 5)],
        "levels": [(at_y(level), name) for name, level in levels.items()],
        "lines": [drawn(line) for line in panel.lines],
    }


def _limits(
    arrays: Sequence[np.ndarray], low: float | None = None, high: float | None = None
) -> tuple[float, float]:
    """Return the ends of an axis: those given, else a little beyond the finite numbers."""
    numbers = np.concatenate([[], *arrays])
    numbers = numbers[np.abs(numbers) < HUGE]
    least, most = (numbers.min(), numbers.max()) if len(numbers) else (0.0, 1.0)
    margin = 0.04 * (most - least) or 0.5 + 0.04 * abs(most)
    low = float(least - margin) if low is None else low
    high = float(most + margin) if high is None else high
    return low, high if high > low else low + 1.0


def _ticks(limits: tuple[float, float], most: int) -> list[float]:
    """Return round numbers within the limits."""
    ticks = MaxNLocator(most, steps=[1, 2, 2.5, 5, 10]).tick_values(*limits)
    return [float(tick) for tick in ticks if limits[0] <= tick <= limits[1]]


def _path(x: np.ndarray, y: np.ndarray, *, apart: bool = False) -> str:
    """Return an SVG path through points, or a dot at each if they are ``apart``; NaN is a gap."""
    there = (np.abs(x) < FAR) & (np.abs(y) < FAR)
    begins = there & ~np.concatenate([[False], there[:-1]])
    return "".join(
        f"{'M' if apart or begin else 'L'}{px:.2f},{py:.2f}{'h0' * apart}"
        for px, py, begin in zip(x[there], y[there], begins[there])
    )
