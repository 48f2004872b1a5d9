"""What was worked out once: read back as it was written, or not at all."""

import os
import random
from collections.abc import Iterator
from pathlib import Path

import pytest

from gyrowheel_core import cache


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Give this test a cache folder of its own."""
    place = tmp_path / "cache"
    monkeypatch.setenv(cache.VARIABLE, str(place))
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    yield place
    cache._folder.cache_clear()


def test_reads_what_was_written(folder: Path) -> None:
    """An entry comes back whole; what is missing is None; others may not read the folder."""
    assert cache.read("entry") is None
    cache.write("entry", b"content")
    assert cache.read("entry") == b"content"
    assert folder.stat().st_mode & 0o077 == 0
    assert (folder / "entry").stat().st_mode & 0o077 == 0


def test_damage_is_never_read(folder: Path) -> None:
    """Whatever happens to the bytes of an entry: it is read as written, or not at all."""
    draw = random.Random(5)
    content = draw.randbytes(300)
    cache.write("entry", content)
    whole = (folder / "entry").read_bytes()
    for _ in range(200):
        damaged = bytearray(whole)
        kind = draw.choice(["flip", "cut", "insert", "empty"])
        at = draw.randrange(len(damaged))
        if kind == "flip":
            damaged[at] ^= 1 << draw.randrange(8)
        elif kind == "cut":
            del damaged[at:]
        elif kind == "insert":
            damaged[at:at] = draw.randbytes(3)
        else:
            damaged.clear()
        (folder / "entry").write_bytes(damaged)
        assert cache.read("entry") is None, kind
    (folder / "entry").write_bytes(whole)
    os.rename(folder / "entry", folder / "other")
    assert cache.read("other") is None  # another entry's content under this name


def test_trusts_nobody_else(folder: Path, tmp_path: Path) -> None:
    """A folder or an entry that others can write to, a link, and a pipe are not read."""
    cache.write("entry", b"content")
    (folder / "entry").chmod(0o666)
    assert cache.read("entry") is None
    cache.write("entry", b"content")
    os.symlink(folder / "entry", folder / "link")
    os.mkfifo(folder / "pipe")
    assert cache.read("link") is None
    assert cache.read("pipe") is None
    folder.chmod(0o777)
    cache._folder.cache_clear()
    assert cache.folder() == tmp_path / f"gyrowheel-cache-{os.geteuid()}"
    cache.write("entry", b"another place")
    assert cache.read("entry") == b"another place"


def test_never_fails(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A full disk leaves neither an error nor a stray file, and where no folder can be trusted there is no cache."""

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    cache.write("entry", b"content")
    with monkeypatch.context() as patched:
        patched.setattr(os, "replace", full)
        cache.write("entry", b"newer")
    assert cache.read("entry") == b"content"
    assert [place.name for place in folder.iterdir()] == ["entry"]
    monkeypatch.setenv(cache.VARIABLE, "/proc/no/such/place")
    monkeypatch.setattr("tempfile.tempdir", "/proc")
    assert cache.folder() is None
    cache.write("entry", b"content")
    assert cache.read("entry") is None
