"""Shared memory of the middleware that dead processes have left behind, and its removal.

A process that is killed leaves its segments in ``/dev/shm``, and the ports that it listened to: megabytes that stay
until the computer is restarted. A process that uses one holds a lock (`flock`) on a file next to it, which ends with
the process.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import re
import time
from collections.abc import Collection
from pathlib import Path
from typing import Final

_SHARED: Final = Path("/dev/shm")
_LOCKS: Final = ("_el", "_sl")  # held by the one process that reads, and by those that share a port
_FILE: Final = re.compile(r"(?:sem\.)?(fastrtps_(?:port\d+|[0-9a-f]{16}))(?:_el|_sl|_mutex)?")
_YOUNG: Final = 10.0  # a file of this age may not have its lock yet [s]


def used_by(pid: int) -> set[str]:
    """Return the shared memory that a process uses: files below ``/dev/shm``."""
    try:
        lines = Path(f"/proc/{pid}/maps").read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:  # it has ended
        return set()
    found = {line.rpartition("/")[2] for line in lines if f"{_SHARED}/fastrtps_" in line}
    return {name.removesuffix(" (deleted)") for name in found}


def remove_dead(place: Path = _SHARED) -> list[str]:
    """Remove all shared memory of this user that no process holds; to be called before nodes are started.

    Parameters
    ----------
    place : Path
        Where it is.

    Returns
    -------
    list of str
        The names of what was removed, in order.
    """
    found: dict[str, list[os.stat_result]] = {}
    with contextlib.suppress(OSError):
        for entry in os.scandir(place):
            match = _FILE.fullmatch(entry.name)
            if match is None or not entry.is_file(follow_symlinks=False):
                continue
            with contextlib.suppress(OSError):
                found.setdefault(match[1], []).append(entry.stat(follow_symlinks=False))
    now, user = time.time(), os.getuid()
    ours = [
        name
        for name, files in found.items()
        if all(f.st_uid == user and now - f.st_mtime > _YOUNG for f in files)
    ]
    return sorted(name for name in ours if _remove(place, name))


def remove_left(names: Collection[str]) -> None:
    """Remove shared memory that killed processes used, unless somebody else holds it.

    `names`: as `used_by` returns them; those already gone are left alone.
    """
    for name in names:
        _remove(_SHARED, name)


def _remove(place: Path, name: str) -> bool:
    if any(_is_locked(place / f"{name}{suffix}") for suffix in _LOCKS):
        return False
    for file in (name, *(f"{name}{suffix}" for suffix in _LOCKS), f"sem.{name}_mutex"):
        with contextlib.suppress(OSError):
            (place / file).unlink(missing_ok=True)
    return True


def _is_locked(path: Path) -> bool:
    try:
        handle = os.open(path, os.O_RDWR | os.O_NOFOLLOW)
    except OSError as error:
        return not isinstance(error, FileNotFoundError)  # belongs to another user
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    finally:
        os.close(handle)
    return False
