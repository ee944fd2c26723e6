import importlib.machinery
import sys
import types

import jax
import pytest

from ailsrs_jax.envs.registry import make_env
from ailsrs_jax.errors import UserError


def with_warp(monkeypatch, installed: bool, backend: str) -> None:
    warp = types.ModuleType("warp")
    warp.__spec__ = importlib.machinery.ModuleSpec("warp", None)
    monkeypatch.setitem(sys.modules, "warp", warp if installed else None)
    monkeypatch.setattr(jax, "default_backend", lambda: backend)


def test_warp_must_be_installed(monkeypatch) -> None:
    with_warp(monkeypatch, False, "gpu")
    with pytest.raises(UserError, match="needs NVIDIA's Warp: pip install warp-lang"):
        make_env("hopper", "warp")


@pytest.mark.parametrize("backend", ["cpu", "tpu"])
def test_warp_needs_a_cuda_device(backend: str, monkeypatch) -> None:
    with_warp(monkeypatch, True, backend)
    with pytest.raises(UserError, match=f"needs a CUDA device, and JAX runs on {backend}: use"):
        make_env("hopper", "warp")


def test_warp_gives_no_contact_forces(monkeypatch) -> None:
    with_warp(monkeypatch, True, "gpu")
    with pytest.raises(UserError, match="no contact forces"):
        make_env("ant", "warp")
