"""Damaged and hostile archives of arrays: demonstrations and policies."""

import io
import json
import warnings
import zipfile
from pathlib import Path

import numpy as np

from tests.fuzz.mutations import Rng, mutate_bytes, mutated_json, odd_value

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

    demonstrations = open_source(path, "Hopper-v5")[0]
    assert np.isfinite(demonstrations.observations).all()
    return demonstrations.subsample(1)
