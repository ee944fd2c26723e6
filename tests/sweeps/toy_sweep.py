"""Grids of tiny cells, and who watches them."""

import csv
from pathlib import Path
from typing import Any

POINT_MASS = "tests.point_mass:PointMass"
SEARCH = {
    "num_iterations": 3,
    "episode_length": 20,
    "num_directions": 4,
    "num_top_directions": 2,
}
TINY = SEARCH | {
    "num_distance_samples": 50,
    "discriminator_batch_size": 16,
    "memory_samples": 16,
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
    """Of what compiles in a second."""
    entry["settings"] = SEARCH | entry.get("settings", {})
    return {"episodes": 2, "algorithm": "ars", "env": POINT_MASS, "grid": [entry]}


class Watch:
    """Notes what it is told, and raises ``error`` before the report of a given number."""

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
