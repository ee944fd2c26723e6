"""Damaged data sets of others' formats."""

import contextlib
import io
import json
import os
import shutil
from pathlib import Path
from typing import Any

import numpy as np

from tests.fuzz.archives import demonstration_arrays, odd_array
from tests.fuzz.mutations import Rng, mutate_bytes, mutate_tree, mutated_json


def make_imitation(path: Path, rng: Rng) -> None:
    import pyarrow as pa

    lengths = [4, 2]
    rows: dict[str, list[Any]] = {
        "obs": [np.ones((n + 1, 3)).tolist() for n in lengths],
        "acts": [np.ones((n, 2)).tolist() for n in lengths],
        "infos": [["{}"] * n for n in lengths],
        "terminal": [True, False],
        "rews": [np.ones(n).tolist() for n in lengths],
    }
    if rng.random() < 0.5:
        name = rng.choice(sorted(rows))
        match rng.randrange(4):
            case 0:
                del rows[name]
            case 1:
                rows[name] = rows[rng.choice(sorted(rows))]
            case _:
                rows[name] = mutate_tree(rows[name], rng)
    try:
        table = pa.table(rows)
    except (pa.ArrowException, OverflowError, ValueError, TypeError, RecursionError):
        table = pa.table({"obs": pa.nulls(2), "terminal": pa.nulls(2)})
    options = pa.ipc.IpcWriteOptions(compression=rng.choice([None, None, "zstd", "lz4"]))
    sink = io.BytesIO()
    with pa.ipc.new_stream(sink, table.schema, options=options) as file:
        file.write_table(table)
    content, state = sink.getvalue(), {"_data_files": [{"filename": "data.arrow"}], "_split": None}
    path.mkdir()
    match rng.randrange(3):
        case 0:
            (path / "state.json").write_bytes(mutated_json(state, rng))
        case _:
            (path / "state.json").write_text(json.dumps(state))
            content = mutate_bytes(content, rng)
    (path / "data.arrow").write_bytes(content)


def minari_original() -> Path:
    """A dataset that Minari wrote itself, once for each process."""
    from ailsrs_jax.data.demonstrations import validated
    from ailsrs_jax.data.episodes import Recording
    from ailsrs_jax.data.formats.minari import save_minari

    root = Path(os.environ["MINARI_DATASETS_PATH"])
    if not (root / "original-v0").exists():
        arrays = demonstration_arrays() | {"stride": np.array(1)}
        arrays["observations"] = np.ones((3, 5, 11), np.float32)
        arrays["actions"] = np.zeros((3, 5, 3), np.float32)
        demonstrations = validated(arrays, "ours")
        recording = Recording(demonstrations, np.ones((3, 5), np.float32), np.ones((3, 11)))
        save_minari(recording, "original-v0")
    return root / "original-v0"


def make_minari(path: Path, rng: Rng) -> None:
    import h5py

    shutil.copytree(minari_original(), path)
    description, data = path / "data" / "metadata.json", path / "data" / "main_data.hdf5"
    match rng.randrange(4):
        case 0:
            tree = json.loads(description.read_text())
            if rng.random() < 0.5:
                name = rng.choice(["env_spec", "observation_space", "action_space"])
                tree[name] = mutated_json(json.loads(tree[name]), rng).decode(errors="replace")
                description.write_text(json.dumps(tree))
            else:
                description.write_bytes(mutated_json(tree, rng))
        case 1 | 2:
            data.write_bytes(mutate_bytes(data.read_bytes(), rng))
        case _:
            with h5py.File(data, "a") as file:
                for _ in range(rng.choice([1, 2])):
                    group = file.get(rng.choice(sorted(file)))
                    name = rng.choice(["observations", "actions", "rewards", "terminations"])
                    item = group.get(name) if isinstance(group, h5py.Group) else None
                    if not isinstance(item, h5py.Dataset) or item.nbytes > 10**6:
                        continue  # it is no longer what it was
                    array = item[()]
                    del group[name]
                    match rng.randrange(7):
                        case 0:
                            pass
                        case 1:
                            group.create_dataset(name, (10**12,), "f4", chunks=(1024,))
                        case 2:
                            group[name] = h5py.ExternalLink("/etc/passwd", "/x")
                        case 3:
                            group[name] = h5py.SoftLink(rng.choice(["/", "/nowhere", group.name]))
                        case 4:  # one more name for something
                            group[name] = rng.choice([*group.values(), group])
                        case _:
                            with contextlib.suppress(TypeError, ValueError):
                                group[name] = odd_array(np.asarray(array), rng)


def read_minari(path: Path) -> object:
    from ailsrs_jax.data.formats.minari import load_minari

    root = Path(os.environ["MINARI_DATASETS_PATH"])
    path.rename(root / "damaged-v0")
    try:
        return load_minari("damaged-v0", "Hopper-v5")
    finally:
        shutil.rmtree(root / "damaged-v0")


def read_imitation(path: Path) -> object:
    from ailsrs_jax.data.sources import open_source

    return open_source(path, "Hopper-v5")
