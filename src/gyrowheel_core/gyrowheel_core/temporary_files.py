"""What is on its way to a path: a hidden file or folder beside it, which goes when its process ends, killed or not.

Each is locked by the process that makes it (`flock`), and a lock ends with its process. What nobody holds any more was
left behind by a killed process, and the next one that makes the same path removes it.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import re
import secrets
import shutil
from collections.abc import Iterator
from pathlib import Path

_TOKEN = 6  # bytes
_LONGEST = 40  # characters of the name; a file system takes 255 bytes


@contextlib.contextmanager
def on_its_way(path: Path, *, folder: bool = False, mode: int = 0o666) -> Iterator[tuple[Path, int]]:
    """Make a hidden file or folder beside a path, for the time of the block.

    Parameters
    ----------
    path : Path
        What it is to become.
    folder : bool
        Whether it is a folder.
    mode : int
        Its permissions, less the process's mask.

    Yields
    ------
    place : Path
        The file or folder. What is left of it at the end of the block is removed.
    descriptor : int
        Its descriptor, which holds the lock.

    Raises
    ------
    OSError
        If it cannot be made.
    """
    _sweep(path)
    place, held = _made(path, folder, mode)
    try:
        yield place, held
    finally:
        _remove(place)
        os.close(held)


def _made(path: Path, folder: bool, mode: int) -> tuple[Path, int]:
    while True:
        place = path.with_name(f".{path.name[:_LONGEST]}.{secrets.token_hex(_TOKEN)}")
        if folder:
            os.mkdir(place, mode)
            held = os.open(place, os.O_RDONLY | os.O_DIRECTORY)
        else:
            held = os.open(place, os.O_CREAT | os.O_EXCL | os.O_WRONLY, mode)
        # between making and locking it another process may have taken it for left behind
        if locked(held) is not False and place.exists():
            return place, held
        os.close(held)


def _sweep(path: Path) -> None:
    """Remove what killed processes left on its way to a path, as far as that is possible."""
    name = re.compile(rf"\.{re.escape(path.name[:_LONGEST])}\.[0-9a-f]{{{2 * _TOKEN}}}")
    with contextlib.suppress(OSError):
        for entry in list(os.scandir(path.parent)):
            if not name.fullmatch(entry.name) or entry.is_symlink():
                continue
            with contextlib.suppress(OSError):
                opened = os.open(entry.path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)
                try:
                    if locked(opened):
                        _remove(Path(entry.path))
                finally:
                    os.close(opened)


def locked(opened: int) -> bool | None:
    """Lock a descriptor; False if another process holds the lock, None where the file system has no locks."""
    try:
        fcntl.flock(opened, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        return None
    return True


def _remove(place: Path) -> None:
    if place.is_dir():
        shutil.rmtree(place, ignore_errors=True)
    else:
        with contextlib.suppress(OSError):
            place.unlink(missing_ok=True)
