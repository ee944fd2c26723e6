"""Grids of tiny cells."""

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


def quick_grid(**entry: Any) -> dict[str, Any]:
    """Of what compiles in a second."""
    entry["settings"] = SEARCH | entry.get("settings", {})
    return {"episodes": 2, "algorithm": "ars", "env": POINT_MASS, "grid": [entry]}
