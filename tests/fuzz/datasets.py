"""Damaged datasets of other libraries."""

import contextlib
import io
import json
import os
import shutil
from pathlib import Path
from typing import Any

import numpy as np
from hypothesis import strategies as st

from tests.fuzz.archives import demonstration_arrays
from tests.fuzz.damage import changed_array, changed_json, changed_tree, damaged_bytes


def make_imitation(draw: st.DrawFn, path: Path) -> None:
    import pyarrow as pa

    lengths = [4, 2]
    rows: dict[str, list[Any]] = {
        "obs": [np.ones((n + 1, 3)).tolist() for n in lengths],
        "acts": [np.ones((n, 2)).tolist() for n in lengths],
        "infos": [["{}"] * n for n in lengths],
        "terminal": [True, False],
        "rews": [np.ones(n).tolist() for n in lengths],
    }
    damaged = draw(st.sampled_from(["rows", "rows", "state", "bytes", "bytes"]))
    if damaged == "rows":
        rows = draw(changed_tree(rows))
    try:
        table = pa.table(rows)
    except (pa.ArrowException, OverflowError, ValueError, TypeError, RecursionError):
        table = pa.table({"obs": pa.nulls(2), "terminal": pa.nulls(2)})
    compression = draw(st.sampled_from([None, None, "zstd", "lz4"]))
    sink = io.BytesIO()
    options = pa.ipc.IpcWriteOptions(compression=compression)
    with pa.ipc.new_stream(sink, table.schema, options=options) as file:
        file.write_table(table)
    content, state = sink.getvalue(), {"_data_files": [{"filename": "data.arrow"}], "_split": None}
    path.mkdir()
    (path / "state.json").write_bytes(
        draw(changed_json(state)) if damaged == "state" else json.dumps(state).encode()
    )
    (path / "data.arrow").write_bytes(
        draw(damaged_bytes(content)) if damaged == "bytes" else content
    )


def read_imitation(path: Path) -> object:
    from ailsrs_jax.data.sources import open_source

    demonstrations, _ = open_source(path, "Hopper-v5")
    assert np.isfinite(demonstrations.observations).all()
    return demonstrations


def minari_original() -> Path:
    """A dataset that Minari itself wrote, the first time this is called."""
    from ailsrs_jax.data.demonstrations import validated
    from ailsrs_jax.data.episodes import Recording, save_minari

    root = Path(os.environ["MINARI_DATASETS_PATH"])
    if not (root / "original-v0").exists():
        arrays = demonstration_arrays() | {"stride": np.array(1)}
        arrays["observations"] = np.ones((3, 5, 11), np.float32)
        arrays["actions"] = np.zeros((3, 5, 3), np.float32)
        demonstrations = validated(arrays, "ours")
        recording = Recording(demonstrations, np.ones((3, 5), np.float32), np.ones((3, 11)))
        save_minari(recording, "original-v0")
    return root / "original-v0"


def make_minari(draw: st.DrawFn, path: Path) -> None:
    import h5py

    shutil.copytree(minari_original(), path)
    description, data = path / "data" / "metadata.json", path / "data" / "main_data.hdf5"
    match draw(st.integers(0, 4)):
        case 0:
            description.write_bytes(draw(changed_json(json.loads(description.read_text()))))
        case 1:
            tree = json.loads(description.read_text())
            name = draw(st.sampled_from(["env_spec", "observation_space", "action_space"]))
            tree[name] = draw(changed_json(json.loads(tree[name]))).decode(errors="replace")
            description.write_text(json.dumps(tree))
        case 2 | 3:
            data.write_bytes(draw(damaged_bytes(data.read_bytes())))
        case _:
            with h5py.File(data, "a") as file:
                group = file[draw(st.sampled_from(sorted(file)))]
                name = draw(st.sampled_from(["observations", "actions", "rewards", "terminations"]))
                array = group[name][()]
                del group[name]
                change_hdf5(draw, group, name, array)


def change_hdf5(draw: st.DrawFn, group: Any, name: str, array: np.ndarray) -> None:
    """Put something else in the place of an array: nothing, a bomb, a link or another array."""
    import h5py

    match draw(st.integers(0, 7)):
        case 0:
            pass
        case 1:
            group.create_dataset(name, (10**12,), "f4", chunks=(1024,))
        case 2:
            group[name] = h5py.ExternalLink("/etc/passwd", "/x")
        case 3:
            group[name] = h5py.SoftLink(draw(st.sampled_from(["/", "/nowhere", group.name])))
        case 4:  # another name of an existing object
            group[name] = draw(st.sampled_from([*group.values(), group]))
        case _:
            with contextlib.suppress(TypeError, ValueError):
                group[name] = draw(changed_array(array))


def read_minari(path: Path) -> object:
    from ailsrs_jax.data.episodes import load_minari

    damaged = Path(os.environ["MINARI_DATASETS_PATH"]) / "damaged-v0"
    shutil.rmtree(damaged, ignore_errors=True)
    path.rename(damaged)
    return load_minari("damaged-v0", "Hopper-v5")
