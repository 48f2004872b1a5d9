"""Cache on disk of computed results: private to the user, verified when it is read.

A cache is never a reason to fail: a result that is missing, damaged, of another user or cannot be written is computed
again.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import importlib.util
import io
import math
import os
import pickle
import re
import secrets
import stat
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

if TYPE_CHECKING:
    from numpy.typing import NDArray

_T = TypeVar("_T")

#: Errors of what cannot be pickled, or was pickled by a version that has its classes elsewhere.
UNREADABLE = (pickle.PickleError, ImportError, AttributeError, TypeError, EOFError, LookupError)
#: Environment variable that names the folder.
VARIABLE = "GYROWHEEL_CACHE"
_WRITABLE_BY_OTHERS = stat.S_IWGRP | stat.S_IWOTH
_DIGEST = hashlib.sha256
_TOKEN = 8  # bytes in the name of an entry that is being written
_HALF = re.compile(rf"\.[0-9a-f]{{{2 * _TOKEN}}}")
_OLD = 3600.0  # s; no entry takes so long to write


def digest(*texts: str) -> str:
    """Return a short name of texts that differs where any of them does."""
    return _DIGEST("\0".join(texts).encode("utf-8", "surrogatepass")).hexdigest()[:20]


@functools.cache
def files_of(*packages: str) -> str:
    """Return a short name of the content of the files of packages: a result of other code has another one."""
    found = []
    for package in packages:
        spec = importlib.util.find_spec(package)
        for place in spec.submodule_search_locations or () if spec else ():
            for path in sorted(Path(place).rglob("*")):
                if path.suffix in (".py", ".yaml", ".json"):
                    found += [package, str(path.relative_to(place)), path.read_text(encoding="utf-8")]
    return digest(*found)


def user_folder(kind: str) -> Path:
    """Return the user's folder of a kind, by the XDG base directory specification.

    Parameters
    ----------
    kind : str
        ``cache``, ``config`` or ``state``.
    """
    usual = {"cache": "~/.cache", "config": "~/.config", "state": "~/.local/state"}[kind]
    return Path(os.environ.get(f"XDG_{kind.upper()}_HOME") or os.path.expanduser(usual))


def folder() -> Path | None:
    """Return the cache folder; None where no folder can be trusted.

    It is ``$GYROWHEEL_CACHE``, else ``gyrowheel`` in the user's cache folder, else a folder per user in the one for
    temporary files: the first that belongs to the user and that nobody else can write to.
    """
    return _folder(os.environ.get(VARIABLE, ""), str(user_folder("cache")), _temporary())


def _temporary() -> str:
    """Return the folder for temporary files; empty if none can be written to."""
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
    """Whether a folder, created if it is missing, belongs to the user and nobody else can write to it."""
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
    """Return the content of an entry; None if it is missing or not as it was written.

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
    """Write an entry if possible: a full or read-only disk is no error."""
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


def computed(
    prefix: str, key: str, most: int, compute: Callable[[], _T], keep: Callable[[_T], bool] = bool
) -> _T:
    """Return a result from the cache; compute and store it if it is missing or cannot be read.

    Parameters
    ----------
    prefix, key : str
        Name of the entry; `key` is a digest of everything that decides the result.
    most : int
        Largest number of entries with this prefix; the oldest are removed.
    compute : callable
        Returns the result.
    keep : callable
        Whether a result is stored; by default any that is not empty.
    """
    name = prefix + key
    if (content := read(name)) is not None:
        with contextlib.suppress(*UNREADABLE):
            found: _T = pickle.loads(content)
            return found
    found = compute()
    if keep(found):
        with contextlib.suppress(*UNREADABLE):
            write(name, pickle.dumps(found))
            keep_latest(prefix, most)
    return found


def keep_latest(prefix: str, most: int, size: float = math.inf) -> None:
    """Remove the oldest entries whose names begin with a prefix, beyond so many or so large in all [bytes]."""
    place = folder()
    if place is None:
        return
    with contextlib.suppress(OSError):
        own = [entry for entry in os.scandir(place) if entry.name.startswith(prefix)]
        found = [entry.stat(follow_symlinks=False) for entry in own]
        total = 0
        for number, k in enumerate(sorted(range(len(own)), key=lambda k: -found[k].st_mtime)):
            total += found[k].st_size
            if number >= most or total > size:
                os.unlink(own[k].path)


def _sweep(place: Path) -> None:
    """Remove entries that killed processes left half-written, long ago."""
    before = time.time() - _OLD
    with contextlib.suppress(OSError):
        for entry in list(os.scandir(place)):
            if _HALF.fullmatch(entry.name) and entry.stat(follow_symlinks=False).st_mtime < before:
                os.unlink(entry.path)


def _checksum(name: str, content: bytes) -> bytes:
    return _DIGEST(name.encode() + b"\0" + content).digest()


def read_arrays(name: str) -> dict[str, NDArray[Any]] | None:
    """Return the arrays of an entry by name; None if it is missing or damaged, see `read`."""
    import zipfile

    import numpy as np

    content = read(name)
    if content is None or not zipfile.is_zipfile(file := io.BytesIO(content)):
        return None
    try:
        with np.load(file, allow_pickle=False) as found:
            return dict(found)
    except (OSError, ValueError, KeyError, zipfile.BadZipFile):
        return None


def write_arrays(name: str, **arrays: Any) -> None:
    """Keep arrays by name, see `write`."""
    import numpy as np

    file = io.BytesIO()
    np.savez(file, **arrays)
    write(name, file.getvalue())
