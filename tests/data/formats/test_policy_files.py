"""The same policy as ``.npz``, ``.safetensors`` and ``.onnx``."""

import itertools
import json
import struct
import sys
from pathlib import Path

import gymnasium
import jax
import numpy as np
import onnx
import pytest

from ailsrs_jax.data.policies import (
    SavedLinearPolicy,
    SavedMlpPolicy,
    SavedPolicy,
    expert_path,
    load_policy,
)
from ailsrs_jax.errors import UserError
from ailsrs_jax.runs.policies import jax_policy
from ailsrs_jax.runs.storage.policies import saved_policy

SIZES = (17, 6)


def random_policy(kind: str, dtype: str = "float32") -> SavedPolicy:
    rng = np.random.default_rng(0)
    n, p = SIZES

    def normal(*shape: int) -> np.ndarray:
        return rng.normal(size=shape).astype(dtype)

    common = {
        "mean": normal(n),
        "std": np.exp(normal(n)),
        "action_low": -np.exp(normal(p)),
        "action_high": np.exp(normal(p)),
        "env_id": "Nowhere-v0",
    }
    if kind == "linear":
        return SavedLinearPolicy(**common, weights=normal(p, n))
    widths = (n, 64, 32, p)
    return SavedMlpPolicy(
        **common,
        weights=tuple(normal(b, a) / np.sqrt(a) for a, b in itertools.pairwise(widths)),
        biases=tuple(normal(b) for b in widths[1:]),
        action_std=np.exp(normal(p)),
    )


POLICIES = {
    "linear": lambda: random_policy("linear"),
    "neural": lambda: random_policy("neural"),
    "Hopper-v5": lambda: load_policy(expert_path("Hopper-v5")),
    "HalfCheetah-v5": lambda: load_policy(expert_path("HalfCheetah-v5")),
}


class Versions:
    """One policy in several formats and libraries; each takes float32 ``(B, n)``."""

    def __init__(self, policy: SavedPolicy, folder: Path) -> None:
        onnxruntime = pytest.importorskip("onnxruntime")
        policy.save(folder / "policy.onnx")
        policy.save(folder / "policy.safetensors")
        session = onnxruntime.InferenceSession(folder / "policy.onnx")
        again = load_policy(folder / "policy.safetensors")
        in_jax = jax.jit(jax.vmap(jax_policy(policy)))
        self.policy = policy
        self.by_name = {
            "ONNX": lambda batch: session.run(["action"], {"observation": batch})[0],
            "JAX": lambda batch: np.asarray(in_jax(batch)),
            "from JAX": saved_policy(jax_policy(policy), policy.env_id),
            "NumPy": lambda batch: np.stack([again(x) for x in batch]),
            "NumPy, all together": again,
        }

    def require_near(self, observations: np.ndarray, tolerance: float = 1e-5) -> None:
        exact = np.stack([self.policy(x) for x in observations.astype(np.float64)])
        for name, version in self.by_name.items():
            actions = version(observations.astype(np.float32))
            np.testing.assert_allclose(actions, exact, rtol=0, atol=tolerance, err_msg=name)

    def scaled(self, scale: float) -> np.ndarray:
        """1000 observations, ``scale`` standard deviations from the mean."""
        noise = np.random.default_rng(1).normal(size=(1000, len(self.policy.mean)))
        return np.float32(self.policy.mean + scale * self.policy.std * noise)


@pytest.fixture(params=POLICIES, scope="module")
def versions(request: pytest.FixtureRequest, tmp_path_factory) -> Versions:
    return Versions(POLICIES[request.param](), tmp_path_factory.mktemp("versions"))


# Up to ten standard deviations, rounding to float32 changes actions by far less than 1e-5. Far
# beyond a thousand, every action or hidden unit is at its bound.
@pytest.mark.parametrize("scale", [0, 1, 10, 1e6, 1e10, 1e20, 1e30])
def test_actions_agree(versions: Versions, scale: float) -> None:
    versions.require_near(versions.scaled(scale))


@pytest.mark.parametrize("scale", [1e2, 1e3, 1e4])
def test_actions_agree_within_rounding(versions: Versions, scale: float) -> None:
    """Here n rounded terms can cancel to an action within its range."""
    rounding = len(versions.policy.mean) * np.finfo(np.float32).eps * scale
    versions.require_near(versions.scaled(scale), 1e-5 + rounding)


def test_actions_agree_on_states_of_the_task(tmp_path: Path) -> None:
    versions = Versions(load_policy(expert_path("Hopper-v5")), tmp_path)
    env = gymnasium.make("Hopper-v5")
    env.action_space.seed(0)
    (observation, _), over, observations = env.reset(seed=0), False, []
    while len(observations) < 1000:
        observations.append(observation)
        random = len(observations) % 3 == 0
        action = env.action_space.sample() if random else versions.policy(observation)
        observation, _, over, *_ = env.step(action)
        if over:
            observation, _ = env.reset()
    versions.require_near(np.array(observations))


def test_nan_gives_nan(versions: Versions) -> None:
    observations = np.full((1, len(versions.policy.mean)), np.nan, np.float32)
    for version in versions.by_name.values():
        assert np.isnan(version(observations)).all()


@pytest.mark.parametrize("kind", ["linear", "neural"])
def test_the_onnx_model_has_the_documented_interface(kind: str, tmp_path: Path) -> None:
    policy = random_policy(kind)
    policy.save(tmp_path / "policy.onnx")
    model = onnx.load(tmp_path / "policy.onnx")
    onnx.checker.check_model(model, full_check=True)
    assert [(x.domain, x.version) for x in model.opset_import] == [("", 13)]
    assert model.ir_version == 7
    assert {x.key: x.value for x in model.metadata_props} == {"env_id": policy.env_id}
    sizes = {"observation": len(policy.mean), "action": len(policy.action_low)}
    for value in (*model.graph.input, *model.graph.output):
        batch, size = value.type.tensor_type.shape.dim
        assert value.type.tensor_type.elem_type == onnx.TensorProto.FLOAT
        assert (batch.dim_param, size.dim_value) == ("batch", sizes.pop(value.name))
    assert not sizes


def test_numbers_beyond_float32_are_refused(tmp_path: Path) -> None:
    fields = vars(random_policy("linear", "float64"))
    for change in ({"std": np.full(17, 1e-50)}, {"weights": np.full((6, 17), 1e39)}):
        policy = SavedLinearPolicy(**(fields | change))
        with pytest.raises(UserError, match="float32"):
            policy.save(tmp_path / "policy.onnx")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("kind", ["linear", "neural"])
@pytest.mark.parametrize("dtype", ["float32", "float64"])
@pytest.mark.parametrize("suffix", [".npz", ".safetensors"])
def test_a_policy_survives_saving_and_loading(
    kind: str, dtype: str, suffix: str, tmp_path: Path
) -> None:
    policy = random_policy(kind, dtype)
    policy.save(tmp_path / f"policy{suffix}")
    again = load_policy(tmp_path / f"policy{suffix}")
    assert type(again) is type(policy)
    assert again.env_id == policy.env_id
    before, after = (jax.tree.leaves(vars(x)) for x in (policy, again))
    for one, other in zip(before, after, strict=True):
        assert np.asarray(one).dtype == np.asarray(other).dtype
        np.testing.assert_array_equal(one, other)


def test_transposed_arrays_are_written_in_order(tmp_path: Path) -> None:
    policy = random_policy("linear")
    transposed = SavedLinearPolicy(**vars(policy) | {"weights": policy.weights.T.copy().T})
    transposed.save(tmp_path / "policy.safetensors")
    again = load_policy(tmp_path / "policy.safetensors")
    np.testing.assert_array_equal(again.weights, policy.weights)


def encoded(tensors: dict, metadata: dict[str, str], body: bytes) -> bytes:
    """A file written after the format's description, without its library."""
    header = json.dumps({"__metadata__": metadata, **tensors}).encode()
    return struct.pack("<Q", len(header)) + header + body


def linear_file(**changes) -> bytes:
    """action = 2 (observation − 1) / 4, between −1 and 1."""
    numbers = {"weights": 2, "mean": 1, "std": 4, "action_low": -1, "action_high": 1}
    numbers |= changes
    metadata, tensors, body = {"env_id": "Nowhere-v0"}, {}, b""
    for name, value in numbers.items():
        if isinstance(value, str):
            metadata[name] = value
        elif value is not None:
            shape = [1, 1] if name == "weights" else [1]
            offsets = [len(body), len(body) + 4]
            tensors[name] = {"dtype": "F32", "shape": shape, "data_offsets": offsets}
            body += struct.pack("<f", value)
    return encoded(tensors, metadata, body)


def test_a_file_from_another_program_is_read(tmp_path: Path) -> None:
    (tmp_path / "policy.safetensors").write_bytes(linear_file())
    policy = load_policy(tmp_path / "policy.safetensors")
    np.testing.assert_array_equal(policy([2.0]), [0.5])
    np.testing.assert_array_equal(policy([9.0]), [1.0])


WRONG = {
    "has no std: not a file of a policy": linear_file(std=None),
    "has no action_std: not a file of a policy": linear_file(weights=None),
    "std is not positive": linear_file(std=0),
    "weights is not made of finite": linear_file(weights=np.nan),
    "mean is (), not (1,)": linear_file(mean="1"),
    "env_id is not the name": linear_file(env_id="\x1b[2J"),
    "is not a .safetensors file of a policy: SafetensorError": linear_file()[:-1],
    "policy: SafetensorError: Error while deserializing header": b"\xff" * 100,
    "of a policy": b"",
    "mean is not made of finite": encoded(
        {
            name: {"dtype": "F16", "shape": shape, "data_offsets": [2 * i, 2 * i + 2]}
            for i, (name, shape) in enumerate(
                {
                    "mean": [1],
                    "std": [1],
                    "action_low": [1],
                    "action_high": [1],
                    "weights": [1, 1],
                }.items()
            )
        },
        {"env_id": "Nowhere-v0"},
        bytes(10),
    ),
}


@pytest.mark.parametrize(("message", "content"), WRONG.items())
def test_damage_is_named(message: str, content: bytes, tmp_path: Path) -> None:
    (tmp_path / "policy.safetensors").write_bytes(content)
    with pytest.raises(UserError) as caught:
        load_policy(tmp_path / "policy.safetensors")
    assert message in str(caught.value)


def test_other_suffixes_are_refused(tmp_path: Path) -> None:
    policy = random_policy("linear")
    for name in ("policy", "policy.pt", "policy.npz.gz"):
        with pytest.raises(UserError, match=r"ends in \.npz, \.safetensors, \.onnx"):
            policy.save(tmp_path / name)
    assert not list(tmp_path.iterdir())
    policy.save(tmp_path / "policy.onnx")
    with pytest.raises(UserError, match=r"\.onnx is for other programs"):
        load_policy(tmp_path / "policy.onnx")
    with pytest.raises(UserError, match="no such file"):
        load_policy(tmp_path / "missing.safetensors")


@pytest.mark.parametrize(
    ("suffix", "package"), {".onnx": "onnx", ".safetensors": "safetensors"}.items()
)
def test_a_missing_package_is_one_line(suffix: str, package: str, tmp_path, monkeypatch) -> None:
    path = tmp_path / f"policy{suffix}"
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(UserError, match=r"need pip install 'ailsrs_jax\[export\]'"):
        random_policy("linear").save(path)
    assert not path.exists()
    if suffix == ".safetensors":
        with pytest.raises(UserError, match=r"need pip install 'ailsrs_jax\[export\]'"):
            load_policy(path)
