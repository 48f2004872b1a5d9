"""Files appear whole or not at all, with the permissions of any other file, or private."""

from __future__ import annotations

import errno
import os
import stat
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from gyrowheel_core.errors import InputError
from gyrowheel_core.files import (
    disk_errors,
    new_directory,
    new_file,
    read_json,
    read_text,
    require_writable,
    write_bytes,
    write_text,
)


@pytest.fixture(params=[0o022, 0o077, 0o002])
def umask(request: pytest.FixtureRequest) -> Iterator[int]:
    before = os.umask(request.param)
    yield request.param
    os.umask(before)


def mode(path: Path) -> int:
    return stat.S_IMODE(path.stat().st_mode)


def test_a_file_has_the_permissions_of_any_new_file(tmp_path: Path, umask: int) -> None:
    write_text(tmp_path / "deep" / "own.txt", "µ")
    (tmp_path / "plain.txt").write_text("")
    assert mode(tmp_path / "deep" / "own.txt") == mode(tmp_path / "plain.txt") == 0o666 & ~umask
    assert (tmp_path / "deep" / "own.txt").read_text(encoding="utf-8") == "µ"
    with new_directory(tmp_path / "folder") as place:
        place.mkdir()
    assert mode(tmp_path / "folder") == 0o777 & ~umask


def test_a_private_file_is_for_its_owner_alone(tmp_path: Path, umask: int) -> None:
    file = tmp_path / "key.json"
    file.write_text("old")
    file.chmod(0o644)
    write_text(file, "new", private=True)
    assert (mode(file), file.read_text()) == (0o600, "new")


def test_an_existing_file_keeps_its_permissions_and_links(tmp_path: Path, umask: int) -> None:
    own, link, far = tmp_path / "own.yaml", tmp_path / "link.yaml", tmp_path / "far" / "new.yaml"
    own.write_text("old")
    own.chmod(0o640)
    link.symlink_to("own.yaml")
    require_writable(link)
    write_text(link, "new")
    assert (link.is_symlink(), own.read_text(), mode(own)) == (True, "new", 0o640)
    (tmp_path / "to_come.yaml").symlink_to(far)
    write_text(tmp_path / "to_come.yaml", "new")
    assert (far.read_text(), (tmp_path / "to_come.yaml").is_symlink()) == ("new", True)
    # one that somebody else may have put into a folder for everybody is none
    if os.geteuid() == 0:
        shared = tmp_path / "shared"
        shared.mkdir()
        shared.chmod(0o1777)
        (shared / "trap").symlink_to(own)
        os.chown(shared / "trap", 65534, 65534, follow_symlinks=False)
        write_text(shared / "trap", "mine")
        assert (own.read_text(), (shared / "trap").is_symlink()) == ("new", False)


def test_the_other_names_of_a_file_keep_its_old_content(tmp_path: Path) -> None:
    """As of a backup by hard links: a changed file is a new one."""
    own, backup = tmp_path / "wheel.yaml", tmp_path / "backup.yaml"
    own.write_text("old")
    backup.hardlink_to(own)
    write_text(own, "new")
    assert (own.read_text(), backup.read_text()) == ("new", "old")


def test_an_error_within_a_new_folder_names_the_folder_and_not_its_temporary_place(tmp_path: Path) -> None:
    with (
        pytest.raises(InputError) as error,
        new_directory(tmp_path / "run") as place,
        disk_errors(place / "run_0.mcap"),
    ):
        raise OSError(errno.ENOSPC, "Error writing bytes to file. Detail: [errno 28] No space left on device")
    assert (
        str(error.value) == f"{tmp_path / 'run' / 'run_0.mcap'}: cannot be written: No space left on device"
    )
    assert not list(tmp_path.iterdir())


def test_an_existing_file_keeps_its_owner_and_group(tmp_path: Path) -> None:
    own = tmp_path / "wheel.yaml"
    own.write_text("old")
    own.chmod(0o640)
    groups = [12345] if os.geteuid() == 0 else [group for group in os.getgroups() if group != os.getegid()]
    if not groups:
        pytest.skip("the user is in one group only")
    os.chown(own, 12345 if os.geteuid() == 0 else -1, groups[0])
    before = own.stat()
    write_text(own, "new")
    after = own.stat()
    assert own.read_text() == "new"
    assert (after.st_uid, after.st_gid, mode(own)) == (before.st_uid, before.st_gid, 0o640)


def test_a_link_to_an_empty_folder_stays(tmp_path: Path) -> None:
    """The folder that it leads to is taken; what nothing can take the place of is refused before the work."""
    far, link = tmp_path / "disk" / "far", tmp_path / "run"
    far.mkdir(parents=True)
    link.symlink_to(far)
    with new_directory(link) as place:
        place.mkdir()
        (place / "a").write_text("x")
    assert link.is_symlink()
    assert [file.name for file in far.iterdir()] == ["a"]
    assert [folder.name for folder in far.parent.iterdir()] == ["far"]


def test_the_root_of_a_file_system_is_refused_before_the_work(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "mounted").mkdir()
    monkeypatch.setattr("os.path.ismount", lambda path: Path(path).name == "mounted")
    with (
        pytest.raises(InputError, match="mounted: is the root of a file system; name a new folder in it"),
        new_directory(tmp_path / "mounted"),
    ):
        pytest.fail("the work has begun")


@pytest.mark.parametrize("name", ["a\0b", "\ud800"])
def test_an_impossible_file_name_is_no_file(name: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot be read: "):
        read_text(tmp_path / name)


@pytest.mark.parametrize("check", [require_writable, lambda file: write_text(file, "new")])
def test_special_and_read_only_files_are_not_replaced(
    check: Callable[[Path], None], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(InputError, match=r"pipe: cannot be written: it is not a file"):
        check(tmp_path / "pipe")
    if os.geteuid() == 0:
        monkeypatch.setattr(os, "access", lambda file, way: bool(os.stat(file).st_mode & 0o200))
    write_text(tmp_path / "own", "old")
    (tmp_path / "own").chmod(0o444)
    with pytest.raises(InputError, match="own: cannot be written: Permission denied"):
        check(tmp_path / "own")
    assert (tmp_path / "own").read_text() == "old"


def test_a_file_is_unchanged_if_writing_fails(tmp_path: Path) -> None:
    file = tmp_path / "a.bin"
    write_bytes(file, b"before")

    def write(error: BaseException) -> None:
        with new_file(file) as place:
            place.write_bytes(b"half")
            raise error

    with pytest.raises(InputError, match=rf"^{file}: cannot be written: No space left on device$"):
        write(OSError(28, "No space left on device"))
    with pytest.raises(KeyboardInterrupt):
        write(KeyboardInterrupt())
    assert (file.read_bytes(), os.listdir(tmp_path)) == (b"before", ["a.bin"])


def test_an_unwritable_place_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    (tmp_path / "folder").mkdir()
    for path in (tmp_path / "file" / "below.txt", tmp_path / "folder", tmp_path / ("long" * 70)):
        with pytest.raises(InputError, match=rf"^{path}: cannot be written: "):
            write_text(path, "x")
        with pytest.raises(InputError, match=rf"^{path}: cannot be written: "):
            require_writable(path)
    assert sorted(os.listdir(tmp_path)) == ["file", "folder"]


def test_a_long_name_can_be_written(tmp_path: Path) -> None:
    file = tmp_path / ("n" * 255)
    write_text(file, "x")
    assert file.read_text() == "x"


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"{", r"not valid JSON \(line 1, column 2\)"),
        (b"[" * 100_000, "not valid JSON: "),
        (b"1" * 5000, "not valid JSON: "),
        (b"\xff\xfe", "not a text file"),
    ],
)
def test_invalid_json_is_refused_in_one_line(tmp_path: Path, content: bytes, said: str) -> None:
    file = tmp_path / "a.json"
    file.write_bytes(content)
    with pytest.raises(InputError, match=rf"^{file}: {said}") as caught:
        read_json(file)
    assert "\n" not in str(caught.value)
    with pytest.raises(InputError, match="cannot be read: "):
        read_json(tmp_path / "none.json")
