"""Every reader of the package, fed with damaged and hostile files.

``python -m tests.fuzz --inputs 100000`` divides so many inputs among the readers and prints a table
of what came out. Each must give a value or one line, within memory and time, write nothing outside
its directory, unpickle nothing and start nothing. An input is a function of its number, so that
``--reader NAME --first NUMBER --inputs 1`` makes the same again.
"""

import argparse
import contextlib
import csv
import dataclasses
import io
import json
import multiprocessing
import os
import random
import resource
import shutil
import sys
import tempfile
import time
import traceback
import warnings
import zipfile
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ailsrs_jax.errors import UserError

Rng = random.Random

MEMORY = 4 * 2**30  # bytes of address space beyond what the imports take
CPU_SECONDS = 20  # after which an input hangs,
WALL_SECONDS = 600  # or, where it only waits: the machine may be busy


class Reader(NamedTuple):
    """One kind of file."""

    weight: int  # share of the inputs: cheap readers get more
    make: Callable[[Path, Rng], None]  # writes a mutated file, or directory, at the path
    read: Callable[[Path], object]


# ---------------------------------------------------------------------------- mutations of anything


def mutate_bytes(content: bytes, rng: Rng) -> bytes:
    """Flip bits, overwrite, cut off, repeat, leave out, and splice."""
    data = bytearray(content)
    for _ in range(rng.choice([1, 1, 1, 2, 4, 16])):
        if not data:
            break
        at = rng.randrange(len(data))
        length = min(rng.choice([1, 1, 2, 4, 8, 64, 1000]), len(data) - at)
        match rng.randrange(8):
            case 0 | 1:
                data[at] ^= 1 << rng.randrange(8)
            case 2:
                data[at : at + length] = rng.randbytes(length)
            case 3:
                del data[rng.choice([at, -at or len(data)]) :]
            case 4:
                del data[at : at + length]
            case 5:
                data[at:at] = data[at : at + length] * rng.choice([1, 2, 100])
            case 6:
                value = rng.choice([0, 0xFF, 0x7F, 0x80])
                data[at : at + length] = bytes([value]) * length
            case 7:
                other = rng.randrange(len(data))
                data[at : at + length] = data[other : other + length]
    return bytes(data)


def odd_value(rng: Rng, depth: int = 0) -> Any:
    """Something that JSON can hold, and a program may not expect."""
    match rng.randrange(14 if depth < 3 else 11):
        case 0:
            return rng.choice([None, True, False, "", {}, []])
        case 1:
            return rng.choice([0, -1, 1, 2**31, 2**63, 2**64, -(2**63), 10**4000])
        case 2:
            return rng.choice([float("nan"), float("inf"), -float("inf"), 1e308, 5e-324, -0.0])
        case 3:
            return "x" * rng.choice([1, 1000, 100_000])
        case 4:
            return rng.choice(["../../../../etc/passwd", "/etc/passwd", "..", ".", "/", "a\0b"])
        case 5:
            return rng.choice(["\n\n", "\x1b[2J", "\ud800", "é" * 50, "os:abort", "posix:_exit"])
        case 6:
            nested: Any = 0
            for _ in range(rng.choice([10, 500, 900])):
                nested = rng.choice([[nested], {"a": nested}])
            return nested
        case 7 | 8 | 9 | 10:
            return rng.choice([rng.random(), rng.randrange(100), "Hopper-v5", "1e5"])
        case 11:
            return [odd_value(rng, depth + 1) for _ in range(rng.randrange(4))]
        case _:
            return {str(odd_value(rng, 9))[:50]: odd_value(rng, depth + 1) for _ in range(3)}


def mutate_tree(tree: Any, rng: Rng) -> Any:
    """Change, leave out or add something somewhere in what JSON holds."""
    if isinstance(tree, dict) and tree and rng.random() < 0.9:
        tree, key = dict(tree), rng.choice(list(tree))
        match rng.randrange(6):
            case 0:
                del tree[key]
            case 1:
                tree[key] = odd_value(rng)
            case 2:
                tree[str(odd_value(rng, 9))[:100]] = odd_value(rng)
            case _:
                tree[key] = mutate_tree(tree[key], rng)
        return tree
    if isinstance(tree, list) and tree and rng.random() < 0.8:
        tree, index = list(tree), rng.randrange(len(tree))
        tree[index] = mutate_tree(tree[index], rng)
        return tree
    return odd_value(rng)


def mutated_json(tree: Any, rng: Rng) -> bytes:
    for _ in range(rng.choice([1, 1, 2, 5])):
        tree = mutate_tree(tree, rng)
    try:
        text = json.dumps(tree).encode()
    except (RecursionError, ValueError):
        text = b"[" * 100_000
    if rng.random() < 0.02:
        text = rng.choice([b"[" * 10**5, b'{"a":' * 10**5, b"9" * 10**5, b" " * 2**21, b""])
    return mutate_bytes(text, rng) if rng.random() < 0.3 else text


# ------------------------------------------------------------------------------------ .npz archives


DTYPES = [
    "f2",
    "f4",
    "f8",
    ">f4",
    "f16",
    "i1",
    "i4",
    "u8",
    "c8",
    "?",
    "U3",
    "U0",
    "S5",
    "V4",
    "M8[s]",
]


def odd_array(array: np.ndarray, rng: Rng) -> np.ndarray:
    """The same with another type, shape or values."""
    with np.errstate(all="ignore"):
        match rng.randrange(8):
            case 0:
                dtype = np.dtype(rng.choice(DTYPES))
                return np.resize(np.frombuffer(bytes(64), np.uint8), array.shape).astype(dtype)
            case 1:
                return np.resize(array, tuple(rng.randrange(4) for _ in range(rng.randrange(5))))
            case 2:
                return array[None] if rng.random() < 0.5 else array.T
            case 3:
                return array.reshape(-1)[: rng.randrange(3)]
            case 4 if array.dtype.kind in "fi":
                array = array.copy()
                value = rng.choice([np.nan, np.inf, -np.inf, 1e38, 1e-45, 0, -1, 2**62])
                array.reshape(-1)[: rng.choice([1, 10**9])] = np.array(value).astype(array.dtype)
                return array
            case 5:
                return np.zeros((0, *array.shape[1:]), array.dtype)
            case 6:
                return np.array(str(odd_value(rng, 9)))
            case _:
                return np.array(rng.choice([0, 1.5, "Hopper-v5", True, 2**63, b"x"]))


def lying_npy(array: np.ndarray, rng: Rng) -> bytes:
    """An ``.npy`` whose header announces something else than it holds."""
    shape = rng.choice(["(10**12,)", "(1000000000000,)", "(2147483648, 3)", "(-1,)", "()", "(1,"])
    descr = rng.choice(
        ["<f4", "<f8", "|O", "<U1000000000", "|V0", "<U0", "f", "[('a','<f4')]", "é"]
    )
    header = f"{{'descr': '{descr}', 'fortran_order': False, 'shape': {shape}, }}"
    header = rng.choice([header, header, "(" * 9000, "{" + "1:" * 50, "9" * 9000, "x"]).encode()
    version = rng.choice([b"\x01\x00", b"\x02\x00", b"\x03\x00", b"\x09\x00"])
    length = len(header).to_bytes(2 if version[0] == 1 else 4, "little")
    return b"\x93NUMPY" + version + length + header + b"\n" + array.tobytes()


def make_npz(arrays: dict[str, np.ndarray], path: Path, rng: Rng) -> None:
    arrays, buffer = dict(arrays), io.BytesIO()
    how = rng.randrange(4)
    for _ in range(rng.choice([1, 1, 2, 4]) if how else 0):
        name = rng.choice(sorted(arrays))
        match rng.randrange(5):
            case 0:
                del arrays[name]
                if not arrays:
                    break
            case 1:
                arrays[name] = arrays[rng.choice(sorted(arrays))]
            case _:
                arrays[name] = odd_array(arrays[name], rng)
    if how < 3:
        (np.savez if rng.random() < 0.5 else np.savez_compressed)(buffer, **arrays)
        content = buffer.getvalue()
        path.write_bytes(mutate_bytes(content, rng) if how == 0 or rng.random() < 0.1 else content)
        return
    with zipfile.ZipFile(
        buffer, "w", rng.choice([zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED])
    ) as file:
        hostile = rng.choice(sorted(arrays)) if arrays else ""
        for name, array in arrays.items():
            plain = io.BytesIO()
            np.save(plain, array, allow_pickle=False)
            content = plain.getvalue()
            entry = f"{name}.npy"
            if name == hostile:
                match rng.randrange(6):
                    case 0 | 1:
                        content = lying_npy(array, rng)
                    case 2:
                        content = mutate_bytes(content, rng)
                    case 3:
                        content = b"cos\nsystem\n(S'touch /tmp/fuzz-was-here'\ntR."
                    case 4:
                        entry = rng.choice([f"../../{entry}", f"/tmp/{entry}", name, f"{entry}/"])
                    case 5 if rng.random() < 0.02:
                        content = content[:128] + bytes(2**29)  # half a gigabyte, in 500 kB
            file.writestr(entry, content)
            if rng.random() < 0.05:
                with warnings.catch_warnings(action="ignore"):
                    file.writestr(entry, b"twice")
    path.write_bytes(buffer.getvalue())


def demonstration_arrays() -> dict[str, np.ndarray]:
    rng = np.random.default_rng(0)
    return {
        "observations": rng.normal(size=(3, 5, 4)).astype(np.float32),
        "actions": rng.normal(size=(3, 5, 2)).astype(np.float32),
        "lengths": np.array([5, 2, 1]),
        "returns": np.array([1.0, 2.0, 3.0], np.float32),
        "env_id": np.array("Hopper-v5"),
        "stride": np.array(2),
    }


def policy_arrays(rng: Rng) -> dict[str, np.ndarray]:
    layers = {
        "weights_0": np.ones((4, 2)),
        "biases_0": np.ones(4),
        "weights_1": np.ones((1, 4)),
        "biases_1": np.ones(1),
        "action_std": np.ones(1),
    }
    return {
        "mean": np.zeros(2),
        "std": np.ones(2),
        "action_low": -np.ones(1),
        "action_high": np.ones(1),
        "env_id": np.array(rng.choice(["Swimmer-v5"] * 8 + ["os:abort", "nowhere:Task"])),
    } | ({"weights": np.ones((1, 2))} if rng.random() < 0.5 else layers)


def make_safetensors(path: Path, rng: Rng) -> None:
    """Arrays and text that its library wrote, or a header that was made up, damaged."""
    from safetensors.numpy import save

    arrays = policy_arrays(rng)
    text = {"env_id": str(arrays.pop("env_id"))}
    for _ in range(rng.choice([0, 0, 1, 2])):
        name = rng.choice(sorted(arrays))
        match rng.randrange(4):
            case 0:
                del arrays[name]
            case 1:
                text[name] = str(odd_value(rng, 9))[:1000]
            case _:
                arrays[name] = odd_array(arrays[name], rng)
    try:
        content = save(arrays, text)
    except Exception:  # it has no types for some of NumPy's, nor for half of a character
        content = save({"mean": np.zeros(2)}, {"env_id": "Swimmer-v5"})
    match rng.randrange(3):
        case 0:
            content = mutate_bytes(content, rng)
        case 1:
            length = int.from_bytes(content[:8], "little")
            header = mutated_json(json.loads(content[8 : 8 + length]), rng)
            told = rng.choice([len(header)] * 8 + [0, 2**40, 2**64 - 1])
            content = told.to_bytes(8, "little") + header + content[8 + length :]
    path.write_bytes(content)


def read_safetensors_policy(path: Path) -> object:
    renamed = path.rename(path.with_suffix(".safetensors"))
    try:
        return read_policy(renamed)
    finally:
        renamed.unlink()


def read_policy(path: Path) -> object:
    from ailsrs_jax.data.policies import load_policy
    from ailsrs_jax.envs.registry import require_harmless

    policy = load_policy(path)
    require_harmless(policy.env_id, str(path))
    with np.errstate(all="ignore"):
        return policy(np.zeros(len(policy.mean)))


def read_demonstrations(path: Path) -> object:
    from ailsrs_jax.data.sources import open_source

    demonstrations = open_source(path, "Hopper-v5", None).demonstrations
    assert np.isfinite(demonstrations.observations).all()
    return demonstrations.subsample(1)


# --------------------------------------------------------------------- configurations and metrics


def config() -> Any:
    from ailsrs_jax.runs.config import RunConfig
    from ailsrs_jax.runs.presets import preset_settings

    return RunConfig(
        env_id="Swimmer-v5",
        physics="mujoco",
        seeds=(0, 5),
        algorithm="ailsrs",
        preset="tuned",
        settings=preset_settings("Swimmer-v5", "tuned"),
        num_trajectories=10,
        demonstrations="of nobody",
        demonstrations_sha256="0" * 64,
        subsample=1,
    )


def read_config(path: Path) -> object:
    from ailsrs_jax.runs import config as configs

    return config().require_same(configs.read_config(path), path)


def make_csv(rows: list[list[Any]], path: Path, rng: Rng) -> None:
    rows = [list(row) for row in rows]
    for _ in range(rng.choice([0, 1, 1, 3])):
        at = rng.randrange(len(rows))
        match rng.randrange(5):
            case 0:
                del rows[at]
            case 1:
                rows.insert(at, list(rows[rng.randrange(len(rows))]))
            case 2:
                rows[at] = rows[at][: rng.randrange(4)]
            case _ if rows[at]:
                rows[at][rng.randrange(len(rows[at]))] = str(odd_value(rng, 9))
        if not rows:
            break
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(rows)
    content = text.getvalue().encode(errors="replace")
    path.write_bytes(mutate_bytes(content, rng) if rng.random() < 0.5 else content)


def make_metrics(path: Path, rng: Rng) -> None:
    rows: list[list[Any]] = [["iteration", "seed", "env_steps", "evaluation_return"]]
    rows += [[i, seed, 80 * i, rng.random()] for i in range(4) for seed in (0, 5)]
    make_csv(rows, path, rng)


def make_run(path: Path, rng: Rng) -> None:
    """What ``ailsrs report`` reads of a run, its configuration or its metrics damaged."""
    path.mkdir()
    columns = ["iteration", "seed", "env_steps", "evaluation_return", "expert_distance"]
    rows = [columns, *([i, seed, 80 * i, 1.5, rng.random()] for i in range(4) for seed in (0, 5))]
    whole = json.dumps(config().as_json()).encode()
    damaged = mutated_json(config().as_json(), rng) if rng.random() < 0.6 else whole
    (path / "config.json").write_bytes(damaged)
    make_csv(rows, path / "metrics.csv", rng)


def read_card(path: Path) -> object:
    from ailsrs_jax.data.policies import expert_path, load_policy
    from ailsrs_jax.runs.evaluation import Evaluation
    from ailsrs_jax.runs.model_card import find_origin, model_card

    policy = load_policy(expert_path("Swimmer-v5"))
    origin = find_origin(policy, path / "seed_5" / "policy.npz")
    card = model_card(policy, Evaluation(np.ones(2), np.ones(2)), "here", origin, "mit")
    assert all(line.isprintable() for line in card.split("\n"))
    return card.encode()


def read_saved_run(path: Path) -> object:
    from ailsrs_jax.runs.saved_run import read_run

    run = read_run(path)
    return run.kept_iterations, run.command(), run.changed_settings()


def make_results(path: Path, rng: Rng) -> None:
    """What a sweep has measured, one of its three tables damaged."""
    from ailsrs_jax.runs.sweep_results import Cell

    words = {"cell": "a", "status": "done", "env_id": "Hopper-v5", "settings": "noise_std=1"}
    names = [field.name for field in dataclasses.fields(Cell)]
    curve, timing = (
        "cell iteration env_steps evaluation_return",
        "cell train_seconds compile_seconds",
    )
    tables: dict[str, list[list[Any]]] = {
        "results.csv": [names, *([words.get(x, i) for x in names] for i in range(2))],
        "curves.csv": [curve.split(), *(["a", i, 10 * i, 0.5] for i in range(3))],
        "timings.csv": [timing.split(), ["a", 1, 2, "", "CPU"]],
    }
    tables["results.csv"][2][0] = "b"
    path.mkdir()
    damaged = rng.choice(sorted(tables))
    for name, rows in tables.items():
        if name == damaged:
            make_csv(rows, path / name, rng)
        else:
            (path / name).write_text("".join(",".join(map(str, row)) + "\n" for row in rows))


def read_sweep_results(path: Path) -> object:
    from ailsrs_jax.runs.sweep_results import read_results

    return [cell.normalized_over_training for cell in read_results(path).cells]


def sweep_spec() -> dict[str, Any]:
    return {
        "episodes": 3,
        "grid": [
            {"env": ["hopper"], "algorithm": "ars", "seeds": [0, 1], "settings": {"noise_std": 1}},
            {"env": "swimmer", "algorithm": "trpo", "label": "b", "settings": {"discount": [1]}},
        ],
    }


def make_spec(path: Path, rng: Rng) -> None:
    """TOML has tables, lists, texts and numbers, as JSON has; only the brackets differ."""
    tree: Any = sweep_spec()
    for _ in range(rng.choice([0, 1, 1, 2])):
        tree = mutate_tree(tree, rng)
    text = toml(tree) if isinstance(tree, dict) else str(tree)
    if rng.random() < 0.03:
        text = "a = " + rng.choice(["[" * 10**5, "{a=" * 10**5, "9" * 10**5, " " * 2**21])
    content = text.encode(errors="replace")
    path.write_bytes(mutate_bytes(content, rng) if rng.random() < 0.3 else content)


def toml(table: dict[str, Any]) -> str:
    """Inline tables only."""
    return "".join(f"{json.dumps(key)} = {toml_value(value)}\n" for key, value in table.items())


def toml_value(value: Any) -> str:
    try:
        if isinstance(value, dict):
            pairs = (f"{json.dumps(key)} = {toml_value(each)}" for key, each in value.items())
            return f"{{{', '.join(pairs)}}}"
        if isinstance(value, list):
            return f"[{', '.join(map(toml_value, value))}]"
        return "''" if value is None else json.dumps(value).replace("Infinity", "inf").lower()
    except (RecursionError, ValueError):
        return "[" * 1000


def read_sweep_spec(path: Path) -> object:
    from ailsrs_jax.runs.sweep_spec import expand, read_spec

    return expand(read_spec(path))


def make_sweep(path: Path, rng: Rng) -> None:
    """The directory of a shard: its grid, or the result of its cell, damaged."""
    from ailsrs_jax.runs.sweep_cells import Cell

    texts = {"name": "a-seed0", "label": "A", "algorithm": "ars", "env_id": "Hopper-v5"}
    cell = {field.name: texts.get(field.name, 1) for field in dataclasses.fields(Cell)}
    files: dict[str, Any] = {
        "sweep.json": {"cells": [cell | {"settings": {}, "all_settings": {}}], "episodes": 3},
        "cells/a-seed0/result.json": {
            "row": {"cell": "a-seed0", "status": "done", "return_mean": 1.0},
            "timing": {"cell": "a-seed0", "train_seconds": 1.0},
        },
    }
    (path / "cells" / "a-seed0").mkdir(parents=True)
    damaged = rng.choice(sorted(files))
    for name, tree in files.items():
        content = mutated_json(tree, rng) if name == damaged else json.dumps(tree).encode()
        (path / name).write_bytes(content)
    rows: list[list[Any]] = [["iteration", "seed", "env_steps"], [0, 0, 10], [1, 0, 20]]
    metrics = path / "cells" / "a-seed0" / "metrics.csv"
    if rng.random() < 0.3:
        make_csv(rows, metrics, rng)
    else:
        metrics.write_text("".join(",".join(map(str, row)) + "\n" for row in rows))


def read_sweep(path: Path) -> object:
    from ailsrs_jax.runs.sweep import merge_sweeps

    return merge_sweeps(path / "merged", [path])


def read_metrics(path: Path) -> object:
    from ailsrs_jax.runs import tracking

    with contextlib.suppress(UserError):  # one of its readers is enough to refuse it
        tracking.MetricsFile(path, (0, 5), 3)
    return tracking.read_metrics(path)


# --------------------------------------------------------------------------- others' data sets


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
    from ailsrs_jax.data.minari_datasets import save_minari

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
                    match rng.randrange(6):
                        case 0:
                            pass
                        case 1:
                            group.create_dataset(name, (10**12,), "f4", chunks=(1024,))
                        case 2:
                            group[name] = h5py.ExternalLink("/etc/passwd", "/x")
                        case 3:
                            group[name] = h5py.SoftLink(rng.choice(["/", "/nowhere", group.name]))
                        case _:
                            with contextlib.suppress(TypeError, ValueError):
                                group[name] = odd_array(np.asarray(array), rng)


def read_minari(path: Path) -> object:
    from ailsrs_jax.data.minari_datasets import load_minari

    root = Path(os.environ["MINARI_DATASETS_PATH"])
    path.rename(root / "damaged-v0")
    try:
        return load_minari("damaged-v0", "Hopper-v5")
    finally:
        shutil.rmtree(root / "damaged-v0")


def read_imitation(path: Path) -> object:
    from ailsrs_jax.data.sources import open_source

    return open_source(path, "Hopper-v5", None)


# --------------------------------------------------------------------------------- checkpoints


def checkpoint_state() -> Any:
    return {"weights": np.arange(12.0).reshape(3, 4), "steps": np.array([3])}


def make_checkpoints(path: Path, rng: Rng) -> None:
    """The newest of two is damaged, half of the time with hashes that match the damage."""
    from ailsrs_jax.runs import checkpoint

    original = Path(os.environ["MINARI_DATASETS_PATH"]) / "checkpoints"
    if not original.exists():
        with checkpoint.Checkpoints(original, 1, {"env_id": "Hopper-v5"}) as checkpoints:
            for num_done in (1, 2):
                checkpoints.save(num_done, checkpoint_state())
    shutil.copytree(original, path)
    newest = path / "2"
    files = [file for file in sorted(newest.rglob("*")) if file.is_file()]
    for file in rng.sample(files, rng.choice([1, 1, 2])):
        match rng.randrange(5):
            case 0:
                file.unlink()
            case 1:
                other = rng.choice([other for other in files if other.exists()])
                file.write_bytes(other.read_bytes())
            case _:
                file.write_bytes(mutate_bytes(file.read_bytes(), rng))
    if rng.random() < 0.5:
        (newest / checkpoint.HASHES).write_text(checkpoint._hashes(newest))


def read_checkpoints(path: Path) -> object:
    from ailsrs_jax.runs.checkpoint import Checkpoints

    with Checkpoints(path, 1) as checkpoints:
        return checkpoints.restore(checkpoint_state()).num_done


def copied(original: Callable[[Rng], Any]) -> Callable[[Path, Rng], None]:
    return lambda path, rng: path.write_bytes(mutated_json(original(rng), rng))


# A reader of another kind of file is another line here.
READERS = {
    "demonstrations": Reader(
        30, lambda path, rng: make_npz(demonstration_arrays(), path, rng), read_demonstrations
    ),
    "policy": Reader(30, lambda path, rng: make_npz(policy_arrays(rng), path, rng), read_policy),
    "safetensors": Reader(20, make_safetensors, read_safetensors_policy),
    "config": Reader(15, copied(lambda _: config().as_json()), read_config),
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


# -------------------------------------------------------------------------------- the machinery


class Watcher:
    """Notes what an input should not be able to bring about, by Python's audit events."""

    FORBIDDEN = ("pickle.", "os.system", "os.exec", "os.fork", "os.posix_spawn")

    def __init__(self, directory: Path) -> None:
        self.events: list[str] = []
        self.watching = False
        self._directory = str(directory)
        sys.addaudithook(self._hear)

    def _hear(self, event: str, arguments: tuple[Any, ...]) -> None:
        if not self.watching:
            return
        if event.startswith((*self.FORBIDDEN, "subprocess.", "socket.connect", "webbrowser.")):
            self.events.append(f"{event} {arguments!r:.200}")
        writes = event in (
            "os.mkdir",
            "os.remove",
            "os.rename",
            "os.link",
            "os.symlink",
            "shutil.move",
        )
        if event == "open" and isinstance(arguments[2], int):
            writes = bool(arguments[2] & (os.O_WRONLY | os.O_RDWR | os.O_CREAT))
        path = arguments[0] if arguments else None
        if writes and isinstance(path, str | bytes | os.PathLike):
            absolute = os.path.abspath(os.fsdecode(path))  # noqa: PTH100 (resolve() opens links)
            if not absolute.startswith((self._directory, os.devnull, "/proc/self")):
                self.events.append(f"{event} {absolute}")


def try_one(reader: Reader, path: Path, seed: str, watcher: Watcher) -> tuple[str, str]:
    """What came of one input: ``value``, ``refused`` or something that should not be."""
    watcher.events = []
    try:
        reader.make(path, Rng(seed))
        watcher.watching = True
        reader.read(path)
        outcome, text = "value", ""
    except UserError as error:
        outcome, text = "refused", str(error)
        if len(text.splitlines()) != 1 or len(text) > 1000 or not text.isprintable():
            outcome = "not one line"
    except BaseException:
        outcome, text = "traceback", traceback.format_exc(limit=-6)
    finally:
        watcher.watching = False
        shutil.rmtree(path, ignore_errors=True)
        path.unlink(missing_ok=True)
    if watcher.events:
        outcome, text = "outside", "; ".join(watcher.events)
    return outcome, text


def work(name: str, first: int, last: int, directory: Path, results: Any) -> None:
    """Try inputs in a process of its own, and tell of each."""
    import jax

    jax.config.update("jax_platforms", "cpu")
    os.chdir(directory)
    os.environ["MINARI_DATASETS_PATH"] = str(directory / "datasets")
    os.environ["XDG_CACHE_HOME"] = str(directory / "cache")
    devnull = os.open(directory / "stderr", os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    os.dup2(devnull, 2)
    warnings.simplefilter("ignore")
    watcher = Watcher(directory)
    reader = READERS[name]
    with contextlib.suppress(Exception):  # imports, and what is made once
        reader.make(directory / "warm", Rng("warm"))
        reader.read(directory / "warm")
    size = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (size + MEMORY, resource.RLIM_INFINITY))
    for number in range(first, last):
        results.send((number, None, ""))
        outcome, text = try_one(reader, directory / "input", f"{name} {number}", watcher)
        results.send((number, outcome, text[:2000]))


def answers(process: Any, results: Any) -> bool:
    """Whether the process says something before it has run or waited for too long."""

    def cpu_seconds() -> float:
        fields = Path(f"/proc/{process.pid}/stat").read_text().rpartition(")")[2].split()
        return sum(map(int, fields[11:13])) / os.sysconf("SC_CLK_TCK")

    started, before = time.monotonic(), cpu_seconds()
    while not results.poll(5):
        waited, ran = time.monotonic() - started, cpu_seconds() - before
        if waited > WALL_SECONDS or ran > CPU_SECONDS:
            return False
    return True


def fuzz(name: str, first: int, last: int, say: Callable[[str], None]) -> Counter[str]:
    """Inputs ``first`` to ``last`` of one reader; counts of outcomes."""
    counts: Counter[str] = Counter()
    context = multiprocessing.get_context("spawn")
    while first < last:
        with tempfile.TemporaryDirectory() as directory:
            results, sender = context.Pipe(duplex=False)
            process = context.Process(
                target=work, args=(name, first, last, Path(directory), sender)
            )
            process.start()
            sender.close()
            number = first
            try:
                while first < last:
                    if not answers(process, results):
                        counts["hang"] += 1
                        say(f"{name} {number}: hang")
                        break
                    number, outcome, text = results.recv()
                    if outcome is None:
                        continue
                    counts[outcome] += 1
                    first = number + 1
                    if outcome not in ("value", "refused"):
                        say(f"{name} {number}: {outcome}: {text}")
            except EOFError:
                process.join()
                counts["crash"] += 1
                say(f"{name} {number}: the process ended with {process.exitcode}")
            else:
                process.kill()
                process.join()
            if first < last:
                first = number + 1
    return counts


def say(line: str) -> None:
    sys.stdout.write(f"{line}\n")
    sys.stdout.flush()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--inputs", type=int, default=1000)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--reader", choices=READERS, nargs="*", default=list(READERS))
    arguments = parser.parse_args()
    total = sum(READERS[name].weight for name in arguments.reader)
    kinds = ("value", "refused", "traceback", "not one line", "outside", "hang", "crash")
    sys.stdout.write(
        f"{'reader':16s}{'inputs':>8s}" + "".join(f"{k:>14s}" for k in kinds) + "   s\n"
    )
    failed = False
    for name in arguments.reader:
        number = arguments.inputs * READERS[name].weight // total
        started = time.perf_counter()
        counts = fuzz(name, arguments.first, arguments.first + number, say)
        row = "".join(f"{counts[kind]:14d}" for kind in kinds)
        seconds = time.perf_counter() - started
        say(f"{name:16s}{counts.total():8d}{row}{seconds:6.0f}")
        failed |= counts.total() > counts["value"] + counts["refused"]
    sys.exit(failed)


if __name__ == "__main__":
    main()
