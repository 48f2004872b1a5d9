"""Files that several processes may change: one at a time, from the reading to the writing."""

from __future__ import annotations

import contextlib
import os
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from gyrowheel_core.errors import InputError
from gyrowheel_core.files import disk_errors
from gyrowheel_core.temporary_files import locked

#: How long a process waits for another one that changes the same file [s].
LONGEST_WAIT = 600.0
_PAUSE = 0.05  # s
#: Lock files that are held, and by which process and thread.
_HOLDING: dict[Path, tuple[int, int]] = {}


@contextlib.contextmanager
def changing(
    file: Path, *, wait: float = LONGEST_WAIT, waiting: Callable[[str], None] | None = None
) -> Iterator[None]:
    """Keep other processes from changing a file while the block reads, changes and writes it.

    The lock is a file beside it, ``.NAME.lock``, which goes when the block ends. It is held by the process and not by
    the file: one that a killed process left behind hinders nobody. A block within a block on the same file takes no
    lock. Where the file system has no locks, nobody is kept: what is written has to be compared with what was read.

    Parameters
    ----------
    file : Path
        The file; it need not exist.
    wait : float
        How long to wait for another process [s].
    waiting : callable, optional
        Called with a line of text once, if there is need to wait.

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
    if _HOLDING.get(place) == own:
        yield
        return
    held = _held(place, file, wait, waiting)
    _HOLDING[place] = own
    try:
        yield
    finally:
        del _HOLDING[place]
        # removed while it is held: whoever opened it before finds that it is not there any more, and begins anew
        with contextlib.suppress(OSError):
            place.unlink()
        os.close(held)


@contextlib.contextmanager
def alone_in(folder: Path, what: str) -> Iterator[None]:
    """Hold a folder while the block works in it: two at a time would undo each other's work.

    Parameters
    ----------
    folder : Path
        The folder, which is there.
    what : str
        What works in it, for the message.

    Raises
    ------
    InputError
        If another process holds it, or it cannot be written to.
    """
    place = folder / ".lock"
    while True:
        with disk_errors(folder):
            opened = _opened(place)
        if locked(opened) is False:
            os.close(opened)
            raise InputError(f"{folder}: another {what} works in this folder")
        if _is_at(opened, place):
            break
        os.close(opened)  # of one that has just ended
    try:
        yield
    finally:
        with contextlib.suppress(OSError):
            place.unlink()
        os.close(opened)


def _held(place: Path, file: Path, wait: float, waiting: Callable[[str], None] | None) -> int:
    """Return a descriptor of the lock file, locked."""
    end = time.monotonic() + wait
    told = False
    while True:
        with disk_errors(file):
            opened = _opened(place)
        try:
            if locked(opened) is not False:  # where the file system has no locks, nobody holds one
                if _is_at(opened, place):
                    held, opened = opened, -1
                    return held
                continue
            if time.monotonic() > end:
                raise InputError(
                    f"{file}: another process has been changing it for {wait:.0f} s; nothing was changed"
                )
            if waiting is not None and not told:
                waiting(f"waiting: another process changes {file}")
                told = True
            time.sleep(_PAUSE)
        finally:
            if opened >= 0:
                os.close(opened)


def _opened(place: Path) -> int:
    """Return a descriptor of a lock file; one that another user has left behind can be locked without writing to it."""
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
        there = place.stat()
    except FileNotFoundError:
        return False
    own = os.fstat(opened)
    return (own.st_dev, own.st_ino) == (there.st_dev, there.st_ino)
