"""Files that several processes change: one after another, and a killed one hinders nobody."""

import errno
import fcntl
import os
import re
import signal
import subprocess
import sys
import textwrap
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path

import pytest

from gyrowheel_core.errors import InputError
from gyrowheel_core.locks import alone_in, changing

_ADDS = """
    import sys
    from pathlib import Path
    from gyrowheel_core.files import read_text, write_text
    from gyrowheel_core.locks import changing

    file = Path(sys.argv[1])
    for _ in range(int(sys.argv[2])):
        with changing(file):
            write_text(file, str(int(read_text(file)) + 1))
"""
_HOLDS = """
    import sys, time
    from pathlib import Path
    from gyrowheel_core.locks import changing

    with changing(Path(sys.argv[1])):
        print("held", flush=True)
        time.sleep(600)
"""


def _process(text: str, *arguments: object) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-c", textwrap.dedent(text), *map(str, arguments)], stdout=subprocess.PIPE, text=True
    )


def test_no_change_is_lost(tmp_path: Path) -> None:
    """Eight processes that each add one to a number 25 times make 200."""
    file = tmp_path / "number"
    file.write_text("0")
    running = [_process(_ADDS, file, 25) for _ in range(8)]
    assert [process.wait(600) for process in running] == [0] * 8
    assert file.read_text() == "200"
    assert [place.name for place in tmp_path.iterdir()] == ["number"]


def test_waiting_for_a_lock_is_reported_and_ends(tmp_path: Path) -> None:
    """Who waits says so, and gives up with an error that names the file; a killed holder leaves nothing behind."""
    file = tmp_path / "wheel.yaml"
    holder = _process(_HOLDS, file)
    assert holder.stdout is not None
    assert holder.stdout.readline() == "held\n"
    said: list[str] = []
    with (
        pytest.raises(InputError, match=rf"process {holder.pid} \(.*\) has been changing it"),
        changing(file, wait=0.2, waiting=said.append),
    ):
        pass
    assert len(said) == 1
    assert re.fullmatch(rf"waiting: process {holder.pid} \(.*\) changes {re.escape(str(file))}", said[0])
    os.kill(holder.pid, signal.SIGKILL)
    holder.wait(240)
    with changing(file, wait=240.0):
        pass
    assert not list(tmp_path.iterdir())


def test_missing_folder_stays_missing(tmp_path: Path) -> None:
    """A lock makes no folder: the file itself does, when it is written."""
    with changing(tmp_path / "no" / "such" / "file"):
        assert not (tmp_path / "no").exists()
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("lock", [changing, lambda path: alone_in(path.parent, "campaign")])
def test_a_file_system_without_locks_and_a_lock_of_another_user(
    lock: Callable[[Path], AbstractContextManager[None]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Neither keeps anybody from changing the file; what a killed process of another user left is locked as it is."""
    file = tmp_path / "wheel.yaml"
    opened = os.open

    def refused(path: Path, flags: int, *mode: int) -> int:
        if flags & os.O_RDWR:
            raise PermissionError(errno.EACCES, "Permission denied")
        return opened(path, flags, *mode)

    for left in (".lock", ".wheel.yaml.lock"):
        (tmp_path / left).touch()
    with monkeypatch.context() as other:
        other.setattr(os, "open", refused)
        with lock(file):
            pass

    def without_locks(descriptor: int, how: int) -> None:
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr(fcntl, "flock", without_locks)
    with lock(file):
        pass
    assert len(list(tmp_path.iterdir())) <= 1  # that of the other kind
