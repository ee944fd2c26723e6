import os
import subprocess
import sys

import pytest

from ailsrs_jax import versions

TESTED = {"jax": "0.9.2", "mujoco": "3.17.0", "mujoco-mjx": "3.17.0"}


def with_versions(monkeypatch: pytest.MonkeyPatch, **changes: str) -> None:
    installed = TESTED | {name.replace("_", "-"): version for name, version in changes.items()}
    monkeypatch.setattr(versions, "version", installed.__getitem__)
    versions.require_supported()


def test_tested_versions_pass(monkeypatch) -> None:
    with_versions(monkeypatch)
    with_versions(monkeypatch, jax="0.9.0")
    with_versions(monkeypatch, jax="0.10.2")
    with_versions(monkeypatch, jax="0.11.2")


@pytest.mark.parametrize("version", ["0.8.3", "0.12.0", "0.90.1", "1.0.0"])
def test_another_jax_is_refused_with_the_version_to_install(version: str, monkeypatch) -> None:
    with pytest.raises(versions.VersionError) as caught:
        with_versions(monkeypatch, jax=version)
    assert str(caught.value).endswith(f"with jax {version}: pip install 'jax>=0.9,<0.12'")


def test_mujoco_and_mjx_must_have_the_same_version(monkeypatch) -> None:
    with pytest.raises(versions.VersionError, match=r"same version: pip install mujoco==3\.17\.0$"):
        with_versions(monkeypatch, mujoco="4.0.0")


@pytest.mark.parametrize(
    ("jax", "flags", "expected"),
    [
        ("0.9.2", None, None),
        ("0.11.2", "--one", "--one"),
        ("0.10.2", None, f"{versions.SCHEDULER}=false"),
        ("0.10.2", "--one", f"--one {versions.SCHEDULER}=false"),
        ("0.10.2", f"{versions.SCHEDULER}=true", f"{versions.SCHEDULER}=true"),
    ],
)
def test_the_deadlock_of_one_version_is_avoided(jax, flags, expected, monkeypatch) -> None:
    monkeypatch.setattr(versions, "version", {"jax": jax}.__getitem__)
    monkeypatch.delenv("XLA_FLAGS", raising=False)
    if flags is not None:
        monkeypatch.setenv("XLA_FLAGS", flags)
    versions.avoid_deadlock()
    assert os.environ.get("XLA_FLAGS") == expected


def test_the_flag_is_set_before_jax_starts() -> None:
    """The installed version decides, in a process of its own."""
    program = "import ailsrs_jax, os, sys; print('jax' in sys.modules, os.environ.get('XLA_FLAGS'))"
    environment = {name: x for name, x in os.environ.items() if name != "XLA_FLAGS"}
    done = subprocess.run(
        [sys.executable, "-c", program], env=environment, capture_output=True, text=True, check=True
    )
    needed = versions.version("jax").startswith("0.10.")
    assert done.stdout.split() == ["False", f"{versions.SCHEDULER}=false" if needed else "None"]


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="cores cannot be taken away here")
def test_a_function_on_the_host_does_not_wait_for_ever_with_one_core() -> None:
    """JAX copies its large arguments in another thread."""
    program = """
import os
os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
from ailsrs_jax.host_calls import host_call
import jax
total = jax.jit(lambda x: host_call(lambda x: x.sum(), jax.ShapeDtypeStruct((), x.dtype), x))
twice = jax.jit(lambda x: 2.0 * x)
sums = [total(twice(jax.numpy.ones(1_000_000))) for _ in range(200)]
print(float(sum(sums)))
"""
    environment = {name: x for name, x in os.environ.items() if name != versions.THREADS}
    done = subprocess.run(
        [sys.executable, "-c", program],
        env=environment,
        capture_output=True,
        text=True,
        check=True,
        timeout=60,
    )
    assert float(done.stdout) == 200 * 2_000_000
