"""The table of all readers, with what is handed to them."""

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from tests.fuzz.archives import (
    demonstration_arrays,
    make_npz,
    make_safetensors,
    policy_arrays,
    read_demonstrations,
    read_policy,
    read_safetensors_policy,
)
from tests.fuzz.datasets import make_imitation, make_minari, read_imitation, read_minari
from tests.fuzz.mutations import Rng
from tests.fuzz.run_files import (
    make_checkpoints,
    make_config,
    make_metrics,
    make_run,
    read_card,
    read_checkpoints,
    read_config,
    read_metrics,
    read_saved_run,
)
from tests.fuzz.sweep_files import (
    make_results,
    make_spec,
    make_sweep,
    read_sweep,
    read_sweep_results,
    read_sweep_spec,
)


class Reader(NamedTuple):
    """One kind of file."""

    weight: int  # share of the inputs: cheap readers get more
    make: Callable[[Path, Rng], None]  # writes a mutated file, or directory, at the path
    read: Callable[[Path], object]


# A reader of another kind of file is another line here.
READERS = {
    "demonstrations": Reader(
        30, lambda path, rng: make_npz(demonstration_arrays(), path, rng), read_demonstrations
    ),
    "policy": Reader(30, lambda path, rng: make_npz(policy_arrays(rng), path, rng), read_policy),
    "safetensors": Reader(20, make_safetensors, read_safetensors_policy),
    "config": Reader(15, make_config, read_config),
    "model card": Reader(5, make_run, read_card),
    "metrics": Reader(10, make_metrics, read_metrics),
    "run": Reader(5, make_run, read_saved_run),
    "results": Reader(5, make_results, read_sweep_results),
    "sweep spec": Reader(4, make_spec, read_sweep_spec),
    "sweep": Reader(5, make_sweep, read_sweep),
    "imitation": Reader(6, make_imitation, read_imitation),
    "minari": Reader(3, make_minari, read_minari),
    "checkpoints": Reader(1, make_checkpoints, read_checkpoints),
}
