"""The table of all readers; a reader of another kind of file is another line in it."""

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from hypothesis import strategies as st

from tests.fuzz import archives, datasets, runs, sweeps


class Reader(NamedTuple):
    """One kind of file."""

    inputs: int  # the number of damaged files in the test suite; slow readers get fewer
    make: Callable[[st.DrawFn, Path], None]  # writes a damaged file or directory
    read: Callable[[Path], object]
    package: str = "numpy"  # that it needs


READERS = {
    "demonstrations": Reader(150, archives.make_demonstrations, archives.read_demonstrations),
    "policy": Reader(150, archives.make_npz_policy, archives.read_policy),
    "safetensors": Reader(
        100, archives.make_safetensors_policy, archives.read_safetensors_policy, "safetensors"
    ),
    "imitation": Reader(60, datasets.make_imitation, datasets.read_imitation, "pyarrow"),
    "minari": Reader(60, datasets.make_minari, datasets.read_minari, "minari"),
    "run": Reader(200, runs.make_run, runs.read_files_of_run),
    "checkpoints": Reader(4, runs.make_checkpoints, runs.read_checkpoints),
    "results": Reader(60, sweeps.make_results, sweeps.read_sweep_results),
    "sweep_spec": Reader(30, sweeps.make_spec, sweeps.read_sweep_spec),
    "sweep": Reader(60, sweeps.make_sweep, sweeps.read_sweep),
}
