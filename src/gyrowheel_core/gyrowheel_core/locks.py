"""Locks of files that several processes change, from the reading to the writing, and of folders that one works in.

Not by the library filelock: it leaves the lock file in the user's folder, refuses one that another user has left there,
and fails where the file system has no locks.
"""

from __future__ import annotations

import contextlib
import os
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from gyrowheel_core.errors import InputError, printable
from gyrowheel_core.files import disk_errors, locked

#: How long a process waits for another one that changes the same file [s].
LONGEST_WAIT = 600.0
_PAUSE = 0.05  # s
_TOLD = 1.0  # s between two reports
#: Locked files, and the process and thread that hold each lock.
_HOLDERS: dict[Path, tuple[int, int]] = {}


@contextlib.contextmanager
def changing(
    file: Path, *, wait: float = LONGEST_WAIT, waiting: Callable[[str], None] | None = None
) -> Iterator[None]:
    """Keep other processes from changing a file while the block reads, changes and writes it.

    The lock is a file next to it, ``.NAME.lock``, which is removed at the end of the block. The process holds the lock:
    a lock file that a killed process left behind blocks nobody. A block within a block on the same file takes no lock.
    A file system without locks keeps nobody away: compare what is to be written over with what was read.

    Parameters
    ----------
    file : Path
        The file; it need not exist.
    wait : float
        How long to wait for another process [s].
    waiting : callable, optional
        Called with a line of text if another process holds the lock, and again every second. What it raises ends the
        wait.

    Raises
    ------
    InputError
        If another process still changes the file after `wait`, or its folder cannot be written to.
    """
    target = Path(os.path.realpath(file))
    folder = target.parent
    while not folder.exists():  # missing folders are made with the file
        folder = folder.parent
    place = folder / f".{target.name[:40]}.lock"
    own = os.getpid(), threading.get_ident()
    if _HOLDERS.get(place) == own:
        yield
        return
    end = time.monotonic() + wait
    told = -_TOLD

    def retry() -> None:
        nonlocal told
        now = time.monotonic()
        if now > end:
            raise InputError(
                f"{file}: {_holder(place)} has been changing it for {wait:.0f} s; nothing was changed"
            )
        if waiting is not None and now > told + _TOLD:
            waiting(f"waiting: {_holder(place)} changes {file}")
            told = now
        time.sleep(_PAUSE)

    with _lock(place, file, retry):
        _HOLDERS[place] = own
        try:
            yield
        finally:
            del _HOLDERS[place]


def _holder(place: Path) -> str:
    """Return the process that holds a lock file in words; Linux lists the locks with their inodes."""
    with contextlib.suppress(OSError):
        inode = place.stat().st_ino
        for line in Path("/proc/locks").read_text(encoding="utf-8").splitlines():
            words = line.split()
            if "FLOCK" in words and words[-3].rpartition(":")[2] == str(inode) and words[-4] != "0":
                name = Path("/proc", words[-4], "comm").read_text(encoding="utf-8", errors="replace").strip()
                return f"process {words[-4]} ({printable(name)})"
    return "another process"


@contextlib.contextmanager
def alone_in(folder: Path, what: str) -> Iterator[None]:
    """Lock a folder while the block works in it: two at a time would undo each other's work.

    Parameters
    ----------
    folder : Path
        The folder, which exists.
    what : str
        What works in it, for the message.

    Raises
    ------
    InputError
        If another process holds the lock, or the folder cannot be written to.
    """

    def refuse() -> None:
        raise InputError(f"{folder}: another {what} works in this folder")

    with _lock(folder / ".lock", folder, refuse):
        yield


@contextlib.contextmanager
def _lock(place: Path, path: Path, busy: Callable[[], None]) -> Iterator[None]:
    """Hold a lock file for the time of the block; call `busy` as long as another process holds it."""
    while True:
        with disk_errors(path):
            opened = _opened(place)
        is_free = locked(opened) is not False  # where the file system has no locks, nobody holds one
        if is_free and _is_at(opened, place):
            break
        os.close(opened)
        if not is_free:
            busy()
    try:
        yield
    finally:
        # removed while it is locked: whoever opened it before finds it gone, and tries again
        with contextlib.suppress(OSError):
            place.unlink()
        os.close(opened)


def _opened(place: Path) -> int:
    """Return a descriptor of a lock file; one that another user has left can be locked without writing to it."""
    flags = os.O_NOFOLLOW | os.O_CLOEXEC | os.O_NONBLOCK
    try:
        return os.open(place, flags | os.O_CREAT | os.O_RDWR, 0o666)
    except PermissionError:
        if not place.exists():
            raise
        return os.open(place, flags | os.O_RDONLY)


def _is_at(opened: int, place: Path) -> bool:
    """Whether an open file is still the one at a path."""
    try:
        return os.path.samestat(os.fstat(opened), place.stat())
    except FileNotFoundError:
        return False
