"""Damaged and hostile archives of arrays: demonstrations and policies."""

import functools
import io
import json
import warnings
import zipfile
from pathlib import Path

import numpy as np
from hypothesis import strategies as st

from tests.fuzz.damage import changed_array, changed_json, damaged_bytes, odd_texts


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


COMMON = {
    "mean": np.zeros(2),
    "std": np.ones(2),
    "action_low": -np.ones(1),
    "action_high": np.ones(1),
}
LAYERS = {
    "weights_0": np.ones((4, 2)),
    "biases_0": np.ones(4),
    "weights_1": np.ones((1, 4)),
    "biases_1": np.ones(1),
    "action_std": np.ones(1),
}


@st.composite
def policy_arrays(draw: st.DrawFn) -> dict[str, np.ndarray]:
    env_id = draw(st.sampled_from((*["Swimmer-v5"] * 8, "os:abort", "nowhere:Task")))
    layers = LAYERS if draw(st.booleans()) else {"weights": np.ones((1, 2))}
    return {**COMMON, **layers, "env_id": np.array(env_id)}


@st.composite
def lying_npy(draw: st.DrawFn, array: np.ndarray) -> bytes:
    """An ``.npy`` file whose header does not describe its content."""
    shape = draw(st.sampled_from(["(10**12,)", "(1000000000000,)", "(2147483648, 3)", "()", "(1,"]))
    kind = draw(st.sampled_from(["<f8", "|O", "<U1000000000", "|V0", "<U0", "[('a','<f4')]", "é"]))
    header = f"{{'descr': '{kind}', 'fortran_order': False, 'shape': {shape}, }}"
    others = ["(" * 9000, "{" + "1:" * 50, "9" * 9000, "x"]
    content = draw(st.sampled_from([header] * 4 + others)).encode()
    version = draw(st.sampled_from([b"\x01\x00", b"\x02\x00", b"\x03\x00", b"\x09\x00"]))
    length = len(content).to_bytes(2 if version[0] == 1 else 4, "little")
    return b"\x93NUMPY" + version + length + content + b"\n" + array.tobytes()


@st.composite
def changed_arrays(draw: st.DrawFn, arrays: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Arrays of which some are missing, swapped or changed."""
    arrays = dict(arrays)
    for name in draw(st.lists(st.sampled_from(sorted(arrays)), max_size=3, unique=True)):
        others = [None, *arrays.values()]
        which = draw(st.integers(0, 2 * len(others) - 1))
        arrays[name] = others[which] if which < len(others) else draw(changed_array(arrays[name]))
    return {name: array for name, array in arrays.items() if array is not None}


PICKLE = b"cos\nsystem\n(S'touch /tmp/fuzz-was-here'\ntR."


def npy(array: np.ndarray) -> bytes:
    buffer = io.BytesIO()
    np.save(buffer, array, allow_pickle=False)
    return buffer.getvalue()


@functools.cache
def bomb(names: tuple[str, ...]) -> bytes:
    """An archive of 300 kB whose first array takes 270 MB."""
    buffer = io.BytesIO()
    np.savez_compressed(
        buffer, **{name: np.zeros(270_000_000 if name == names[0] else 1, bool) for name in names}
    )
    return buffer.getvalue()


@st.composite
def npz_files(draw: st.DrawFn, arrays: dict[str, np.ndarray]) -> bytes:
    """Changed arrays, damaged bytes, a bomb, or an archive with one hostile entry."""
    buffer, kind = io.BytesIO(), draw(st.integers(0, 19))
    if kind == 0:
        return bomb(tuple(arrays))
    if kind < 14:
        save = np.savez if draw(st.booleans()) else np.savez_compressed
        save(buffer, **draw(changed_arrays(arrays)))
        return draw(damaged_bytes(buffer.getvalue())) if kind < 6 else buffer.getvalue()
    hostile = draw(st.sampled_from(sorted(arrays)))
    with zipfile.ZipFile(buffer, "w") as file, warnings.catch_warnings(action="ignore"):
        for name, array in arrays.items():
            content, entry = npy(array), f"{name}.npy"
            if name == hostile:
                contents = damaged_bytes(content) | lying_npy(array) | st.just(PICKLE)
                names = [entry] * 4 + [f"../../{entry}", f"/tmp/{entry}", name, f"{entry}/"]
                content, entry = draw(contents), draw(st.sampled_from(names))
                file.writestr(entry, b"an entry with the same name")
            file.writestr(entry, content)
    return buffer.getvalue()


@st.composite
def safetensors_files(draw: st.DrawFn) -> bytes:
    """A file that the library wrote, with changed arrays, a changed header or damaged bytes."""
    from safetensors.numpy import save

    arrays = draw(policy_arrays())
    text = {"env_id": str(arrays.pop("env_id"))}
    arrays = draw(changed_arrays(arrays))
    text |= draw(st.dictionaries(st.sampled_from(["mean", "env_id"]), odd_texts, max_size=1))
    try:
        content = save({name: np.ascontiguousarray(x) for name, x in arrays.items()}, text)
    except Exception:  # the library lacks some of NumPy's types, and refuses lone surrogates
        content = save({"mean": np.zeros(2)}, {"env_id": "Swimmer-v5"})
    length = int.from_bytes(content[:8], "little")
    # The library writes the texts in a random order.
    tree = json.loads(content[8 : 8 + length], object_pairs_hook=lambda x: dict(sorted(x)))
    header = json.dumps(tree).encode()
    content = len(header).to_bytes(8, "little") + header + content[8 + length :]
    length, header = len(header), draw(changed_json(tree))
    told = draw(st.sampled_from([len(header)] * 8 + [0, 2**40, 2**64 - 1]))
    changed = told.to_bytes(8, "little") + header + content[8 + length :]
    return draw(st.sampled_from([content, content, changed]) | damaged_bytes(content))


def make_demonstrations(draw: st.DrawFn, path: Path) -> None:
    path.write_bytes(draw(npz_files(demonstration_arrays())))


def make_npz_policy(draw: st.DrawFn, path: Path) -> None:
    path.write_bytes(draw(npz_files(draw(policy_arrays()))))


def make_safetensors_policy(draw: st.DrawFn, path: Path) -> None:
    path.write_bytes(draw(safetensors_files()))


def read_policy(path: Path) -> object:
    from ailsrs_jax.data.policies import load_policy
    from ailsrs_jax.envs.registry import require_harmless

    policy = load_policy(path)
    require_harmless(policy.env_id, str(path))
    with np.errstate(all="ignore"):
        return policy(np.zeros(len(policy.mean)))


def read_safetensors_policy(path: Path) -> object:
    renamed = path.with_suffix(".safetensors")
    path.replace(renamed)
    return read_policy(renamed)


def read_demonstrations(path: Path) -> object:
    from ailsrs_jax.data.sources import open_source

    demonstrations = open_source(path, "Hopper-v5")[0]
    assert np.isfinite(demonstrations.observations).all()
    return demonstrations.subsample(1)
