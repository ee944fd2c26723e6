"""Fixtures of the tests of sweeps."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest

import ailsrs_jax as ail
from ailsrs_jax.data.demonstrations import Demonstrations, save_demonstrations
from ailsrs_jax.runs.storage.checkpoint import Checkpoints
from tests.sweeps.toy_sweep import POINT_MASS, two_cells


@pytest.fixture
def demonstrations(in_tmp_path: Path, point_mass_expert: Demonstrations) -> str:
    """A file with demonstrations of the point mass, in the current directory."""
    short = jax.tree.map(lambda x: x[:, :20] if x.ndim > 1 else x, point_mass_expert)
    lengths = np.minimum(short.lengths, 20)  # as long as the episodes of these tests
    save_demonstrations(short.replace(env_id=POINT_MASS, lengths=lengths), "point_mass.npz")
    return "point_mass.npz"


@pytest.fixture(autouse=True)
def every_tenth_iteration_is_saved(monkeypatch: pytest.MonkeyPatch) -> None:
    """These iterations are so short that otherwise only the first would be."""
    monkeypatch.setattr(Checkpoints, "rest", lambda *_: None)


@pytest.fixture(scope="session")
def one_by_one(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[Any]]:
    """A sweep of ``two_cells``, trained one after the other: its directory and its rows."""
    directory = tmp_path_factory.mktemp("sweep") / "whole"
    return directory, ail.sweep(two_cells(), directory, max_parallel=1)


@pytest.fixture(scope="session", autouse=True)
def compiled_once(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Keep even the smallest compiled programs, because these tests train the same cells often."""
    options = {
        "jax_compilation_cache_dir": str(tmp_path_factory.mktemp("xla")),
        "jax_persistent_cache_min_compile_time_secs": 0.0,
        "jax_persistent_cache_min_entry_size_bytes": 0,
    }
    before = {name: jax.config.values[name] for name in options}
    for name, value in options.items():
        jax.config.update(name, value)
    yield
    for name, value in before.items():
        jax.config.update(name, value)
