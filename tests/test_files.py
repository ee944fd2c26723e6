import os
import threading
from pathlib import Path

import numpy as np
import pytest

from ailsrs_jax import files
from ailsrs_jax.data.formats.npz import read_npz
from ailsrs_jax.data.sources import open_source
from ailsrs_jax.errors import UserError


def test_a_bomb_is_not_unpacked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The zeros after short episodes are not taken for a bomb."""
    path = tmp_path / "zeros.npz"
    np.savez_compressed(path, observations=np.zeros((40, 1000, 100)))
    assert read_npz(path, ("observations",), "anything")["observations"].size == 4_000_000
    monkeypatch.setattr(files, "SMALL", 2**20)
    with pytest.raises(UserError, match=r"would grow from .* bytes to 32,000,128, so"):
        read_npz(path, ("observations",), "demonstrations")


def test_a_pipe_is_refused_without_blocking(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.npz")
    errors: list[str] = []

    def read() -> None:
        try:
            open_source(tmp_path / "pipe.npz", "Hopper-v5")
        except UserError as error:
            errors.append(str(error))

    thread = threading.Thread(target=read, daemon=True)
    thread.start()
    thread.join(30)
    assert errors == [f"{tmp_path / 'pipe.npz'} is not a file"]


NO_OBJECTS = [b"", b"[]", b"9" * 5000, b" " * 2**21, b"\xff{}", b'{"a": "\\ud800"}']


@pytest.mark.parametrize("content", [*NO_OBJECTS, b"[" * 10**5, b'{"a": ' * 10**5])
def test_anything_but_a_json_object_is_refused(content: bytes, tmp_path: Path) -> None:
    (tmp_path / "file.json").write_bytes(content)
    with pytest.raises(UserError, match="is not a greeting: "):
        files.read_json_object(tmp_path / "file.json", "a greeting")


def test_every_message_is_one_short_printable_line() -> None:
    message = str(UserError("no such file: a\nb\x1b[2J\ud800" + "x" * 10**6))
    assert message.startswith("no such file: a\\nb\\x1b[2J\\ud800xxx")
    assert len(message) == 1000
    assert message.isprintable()


def test_a_link_is_written_through(tmp_path: Path) -> None:
    """The link stays, also where its target is new, and nothing else is left anywhere."""
    target, link = tmp_path / "there" / "target", tmp_path / "link"
    link.symlink_to("there/target")
    for content in (b"new", b"newer"):
        files.require_writable(link)
        files.write_atomically(link, content)
        assert link.is_symlink()
        assert target.read_bytes() == content
    assert sorted(tmp_path.rglob("*")) == [link, target.parent, target]


def test_what_is_not_a_regular_file_is_refused(tmp_path: Path) -> None:
    fifo, device, circle = (tmp_path / name for name in ("fifo", "device", "circle"))
    os.mkfifo(fifo)
    device.symlink_to(os.devnull)
    circle.symlink_to(circle)
    for path in (fifo, device, circle, tmp_path):
        for write in (files.require_writable, lambda path: files.write_atomically(path, b"")):
            with pytest.raises(UserError, match=f"^cannot write {path}: (it is not a|Too many)"):
                write(path)
    assert fifo.is_fifo()
    assert device.is_char_device()
    assert sorted(tmp_path.iterdir()) == [circle, device, fifo]


def test_the_umask_gives_the_permissions_of_a_new_file_only(tmp_path: Path) -> None:
    path = tmp_path / "file"
    before = os.umask(0o027)
    try:
        files.write_atomically(path, b"new")
        assert path.stat().st_mode & 0o777 == 0o640
        path.chmod(0o606)
        files.write_atomically(path, b"newer")
        assert path.stat().st_mode & 0o777 == 0o606
    finally:
        os.umask(before)


def test_a_failed_write_leaves_the_old_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "file"
    files.write_atomically(path, b"old")

    def fail(_: int) -> None:
        raise KeyError("mine")

    monkeypatch.setattr(files.os, "fsync", fail)  # when all is written, but not renamed
    with pytest.raises(KeyError):
        files.write_atomically(path, "new")
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]
