"""What was worked out once: read back as it was written, or not at all."""

import os
import random
import shutil
import subprocess
from collections.abc import Callable, Iterator
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


def test_cache_reads_back_its_entries(folder: Path) -> None:
    """An entry comes back whole; what is missing is None; others may not read the folder."""
    assert cache.read("entry") is None
    cache.write("entry", b"content")
    assert cache.read("entry") == b"content"
    assert folder.stat().st_mode & 0o077 == 0
    assert (folder / "entry").stat().st_mode & 0o077 == 0


def test_damaged_cache_entries_are_never_read(folder: Path) -> None:
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


def _kept_or_made(name: str) -> bytes:
    """Return what is worked out under a name, as everything that uses the cache does."""
    found = cache.read(name)
    if found is None:
        found = name.encode() * 20
        cache.write(name, found)
    return found


def test_results_do_not_depend_on_the_state_of_the_cache_folder(folder: Path) -> None:
    """Two hundred times, something is done to an entry or to the folder: the result is that of a fresh one."""
    draw = random.Random(6)
    fresh = _kept_or_made("entry")
    other = _kept_or_made("other")
    place = folder / "entry"
    owners = (1, 12345, 65534) if os.geteuid() == 0 else ()

    def overwrite() -> None:
        content = bytearray(place.read_bytes()) if place.is_file() else bytearray(b"x")
        at = draw.randrange(max(len(content), 1))
        content[at : at + draw.randrange(9)] = draw.randbytes(draw.randrange(9))
        place.write_bytes(content)

    def instead(make: Callable[[], None]) -> Callable[[], None]:
        def deed() -> None:
            place.unlink()
            make()

        return deed

    deeds: dict[str, Callable[[], object]] = {
        "overwritten": overwrite,
        "empty": lambda: place.write_bytes(b""),
        "of another version": lambda: place.write_bytes((folder / "other").read_bytes()),
        "a link": instead(lambda: place.symlink_to(folder / "other")),
        "a pipe": instead(lambda: os.mkfifo(place)),
        "a folder": instead(place.mkdir),
        "gone": place.unlink,
        "writable by others": lambda: place.chmod(0o666),
        "unreadable": lambda: place.chmod(0),
        "of another owner": lambda: os.chown(place, draw.choice(owners), -1),
        "in a folder of another owner": lambda: os.chown(folder, draw.choice(owners), -1),
        "in a folder that others may write to": lambda: folder.chmod(0o777),
        "in a folder that is read-only": lambda: folder.chmod(0o500),
        "without a folder": lambda: shutil.rmtree(folder),
    }
    for _ in range(200):
        what = draw.choice([name for name in deeds if owners or "owner" not in name])
        deeds[what]()
        cache._folder.cache_clear()  # another process looks anew
        assert _kept_or_made("entry") == fresh, what
        assert _kept_or_made("other") == other, what
        # as it was
        folder.mkdir(exist_ok=True)
        os.chown(folder, os.geteuid(), -1)
        folder.chmod(0o700)
        if place.is_dir():
            place.rmdir()
        place.unlink(missing_ok=True)
        cache._folder.cache_clear()
        assert _kept_or_made("entry") == fresh
        assert place.is_file()


def test_a_full_or_read_only_disk_disables_the_cache(folder: Path, tmp_path: Path) -> None:
    """What is in the cache is read, what is not is worked out, and no half of an entry stays."""
    folder.mkdir(mode=0o700)
    if subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=8k,mode=700", "tmpfs", str(folder)], check=False
    ).returncode:
        pytest.skip("file systems cannot be mounted here")
    try:
        fresh = _kept_or_made("entry")
        (folder / "filling").write_bytes(bytes(4096))
        assert _kept_or_made("late") == b"late" * 20
        assert cache.read("late") is None
        assert sorted(place.name for place in folder.iterdir()) == ["entry", "filling"]
        subprocess.run(["mount", "-o", "remount,ro", str(folder)], check=True)
        assert cache.read("entry") == fresh
        assert _kept_or_made("late") == b"late" * 20
    finally:
        subprocess.run(["umount", str(folder)], check=True)


def test_entries_that_others_can_write_are_not_read(folder: Path, tmp_path: Path) -> None:
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


def test_the_cache_never_fails(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
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


def test_no_folder_for_temporary_files(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where Python finds no such folder at all there is no cache, and no error."""

    def none() -> str:
        raise FileNotFoundError(2, "No usable temporary directory found")

    monkeypatch.setenv(cache.VARIABLE, "/proc/no/such/place")
    monkeypatch.setattr("tempfile.gettempdir", none)
    assert cache.folder() is None
    assert _kept_or_made("entry") == b"entry" * 20


def test_remains_of_a_killed_process_in_the_cache_are_removed(folder: Path) -> None:
    """An entry half-written an hour ago is removed; one that may still be on its way and what is no entry stay."""
    cache.write("entry", b"content")
    for name, old in ((f".{'0' * 16}", True), (f".{'1' * 16}", False), (".0123", True), ("matplotlib", True)):
        (folder / name).write_bytes(b"half")
        if old:
            os.utime(folder / name, (1.0, 1.0))
    cache.write("other", b"content")
    assert {place.name for place in folder.iterdir()} == {
        "entry", "other", f".{'1' * 16}", ".0123", "matplotlib",
    }  # fmt: skip
