"""Grids of tiny cells, and an observer of sweeps."""

import csv
from pathlib import Path
from typing import Any

POINT_MASS = "tests.point_mass:PointMass"
SEARCH = {
    "num_iterations": 3,
    "episode_length": 20,
    "num_directions": 1,
    "num_top_directions": 1,
}
TINY = SEARCH | {
    "num_distance_samples": 50,
    "discriminator_batch_size": 16,
    "memory_samples": 16,
    "leave_out_beyond": 0.0,
}


def grid(demonstrations: str, **entry: Any) -> dict[str, Any]:
    return {
        "episodes": 2,
        "env": POINT_MASS,
        "demonstrations": demonstrations,
        "settings": TINY,
        "grid": [entry],
    }


def table(path: Path) -> list[dict[str, str]]:
    with path.open() as file:
        return list(csv.DictReader(file))


def quick_grid(**entry: Any) -> dict[str, Any]:
    """Make a grid of cells that compile in a second."""
    entry["settings"] = SEARCH | entry.get("settings", {})
    return {"episodes": 2, "algorithm": "ars", "env": POINT_MASS, "grid": [entry]}


def two_cells() -> dict[str, Any]:
    """Make a grid of two cells, which are trained for more iterations than between checkpoints."""
    return quick_grid(seeds=[0, 1], settings={"num_iterations": 12})


class Watch:
    """Records calls, and raises ``error`` instead of recording the report of number ``at``."""

    def __init__(self, error: BaseException | None = None, at: int = 0) -> None:
        self.error, self.at = error, at
        self.begun: list[str] = []
        self.rows: list[Any] = []
        self.num_reports = 0

    def begin(self, cells: Any) -> None:
        assert cells
        self.begun += [cell.name for cell in cells]

    def __call__(self, report: Any) -> None:
        if self.num_reports == self.at and self.error is not None:
            error, self.error = self.error, None
            raise error
        self.num_reports += 1

    def end(self, row: Any) -> None:
        self.rows.append(row)
