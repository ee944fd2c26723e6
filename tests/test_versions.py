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


@pytest.mark.parametrize("version", ["0.8.3", "0.10.0", "0.90.1", "1.0.0"])
def test_another_jax_is_refused_with_the_version_to_install(version: str, monkeypatch) -> None:
    with pytest.raises(versions.VersionError) as caught:
        with_versions(monkeypatch, jax=version)
    assert str(caught.value).endswith(f"with jax {version}: pip install 'jax>=0.9,<0.10'")


def test_mujoco_and_mjx_must_have_the_same_version(monkeypatch) -> None:
    with pytest.raises(versions.VersionError, match=r"same version: pip install mujoco==3\.17\.0$"):
        with_versions(monkeypatch, mujoco="4.0.0")
