"""What was worked out once, kept on disk for the next process: private to the user, and checked as it is read.

A cache is never a reason to fail: what is missing, damaged, of another user or cannot be written is worked out anew.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import os
import re
import secrets
import stat
import tempfile
import time
from pathlib import Path

#: Environment variable that names the folder.
VARIABLE = "GYROWHEEL_CACHE"
_WRITABLE_BY_OTHERS = stat.S_IWGRP | stat.S_IWOTH
_DIGEST = hashlib.sha256
_TOKEN = 8  # bytes in the name of an entry on its way
_HALF = re.compile(rf"\.[0-9a-f]{{{2 * _TOKEN}}}")
_OLD = 3600.0  # s; no entry takes so long to write


def digest(*texts: str) -> str:
    """Return a short name of texts: another one where any of them differs."""
    return _DIGEST("\0".join(texts).encode("utf-8", "surrogatepass")).hexdigest()[:20]


def folder() -> Path | None:
    """Return the cache folder; None where no folder can be trusted.

    It is ``$GYROWHEEL_CACHE``, else ``gyrowheel`` in the user's cache folder, else one folder a user in the folder for
    temporary files; the first of them that is the user's own and that nobody else can write to.
    """
    return _folder(
        os.environ.get(VARIABLE, ""),
        os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache"),
        _temporary(),
    )


def _temporary() -> str:
    """Return the folder for temporary files; empty where there is none that can be written to."""
    try:
        return tempfile.gettempdir()
    except OSError:
        return ""


@functools.cache
def _folder(named: str, usual: str, temporary: str) -> Path | None:
    places = [Path(named)] if named else [Path(usual) / "gyrowheel"]
    for place in (*places, Path(temporary) / f"gyrowheel-cache-{os.geteuid()}"):
        if place.is_absolute() and _is_private(place):
            return place
    return None


def _is_private(place: Path) -> bool:
    """Whether a folder, made if it is missing, is the user's own and nobody else can write to it."""
    try:
        place.mkdir(mode=0o700, parents=True, exist_ok=True)
        found = place.lstat()
    except OSError:
        return False
    return (
        stat.S_ISDIR(found.st_mode)
        and found.st_uid == os.geteuid()
        and not found.st_mode & _WRITABLE_BY_OTHERS
    )


def read(name: str) -> bytes | None:
    """Return what was kept under a name; None if nothing was, or if it is not what was written.

    The checksum in front of the content covers its name, so that a file under another name counts as damaged.
    """
    place = folder()
    if place is None:
        return None
    try:
        opened = os.open(place / name, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)
        with os.fdopen(opened, "rb") as file:
            found = os.fstat(file.fileno())
            if (
                not stat.S_ISREG(found.st_mode)
                or found.st_uid != os.geteuid()
                or found.st_mode & _WRITABLE_BY_OTHERS
            ):
                return None
            content = file.read()
    except OSError:
        return None
    size = _DIGEST().digest_size
    checksum, content = content[:size], content[size:]
    return content if checksum == _checksum(name, content) else None


def write(name: str, content: bytes) -> None:
    """Keep content under a name, as well as that is possible: a full or read-only disk is no error."""
    place = folder()
    if place is None:
        return
    _sweep(place)
    written = place / f".{secrets.token_hex(_TOKEN)}"
    try:
        opened = os.open(written, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o600)
        with os.fdopen(opened, "wb") as file:
            file.write(_checksum(name, content) + content)
        os.replace(written, place / name)
    except OSError:
        with contextlib.suppress(OSError):
            written.unlink(missing_ok=True)


def _sweep(place: Path) -> None:
    """Remove entries that killed processes left half-written, long ago."""
    before = time.time() - _OLD
    with contextlib.suppress(OSError):
        for entry in list(os.scandir(place)):
            if _HALF.fullmatch(entry.name) and entry.stat(follow_symlinks=False).st_mtime < before:
                os.unlink(entry.path)


def _checksum(name: str, content: bytes) -> bytes:
    return _DIGEST(name.encode() + b"\0" + content).digest()
