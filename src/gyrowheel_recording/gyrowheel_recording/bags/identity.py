"""Whether the files of a recording are still those that were read: their states when it was read, and their hashes."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from gyrowheel_core.errors import InputError
from gyrowheel_core.files import read_errors

#: Endings of the files that a recording is made of; others in its folder are not read.
_ENDINGS = (".yaml", ".mcap", ".db3", ".zstd")
_LOGS = ("-wal", "-journal")  # next to a database that was not closed, which is read with them


@dataclass(frozen=True)
class FileState:
    """A file of a recording at one instant; any change of the file changes it."""

    path: Path  # absolute
    name: str  # in the folder of the recording
    size: int  # bytes
    #: Device, inode, and the times of the last change of its content and of its inode [ns].
    state: tuple[int, int, int, int]


@dataclass(frozen=True)
class HashedFile:
    """A file of a recording with the SHA-256 of its content."""

    name: str
    size: int  # bytes
    sha256: str


def files_of(recording: Path) -> tuple[FileState, ...]:
    """Return the files of which a recording is made, as they are now; those that are not there are left out."""
    place = recording.absolute()
    with read_errors(recording):
        if place.is_dir():
            names = [own.name for own in os.scandir(place) if own.name.endswith((*_ENDINGS, *_LOGS))]
        else:
            names, place = [place.name, *(f"{place.name}{end}" for end in _LOGS)], place.parent
        return tuple(_state(place, name) for name in sorted(names) if (place / name).is_file())


def same(before: Sequence[FileState], recording: Path) -> bool:
    """Return whether the files of a recording are still in the states that they were in before."""
    return set(before) <= set(files_of(recording))


def _state(folder: Path, name: str) -> FileState:
    path = folder / name
    found = path.stat()
    # SQLite sets the owner of a log that it opens, which changes the inode
    changed = found.st_mtime_ns if name.endswith(_LOGS) else found.st_ctime_ns
    return FileState(path, name, found.st_size, (found.st_dev, found.st_ino, found.st_mtime_ns, changed))


def hashed(files: Sequence[FileState]) -> tuple[HashedFile, ...]:
    """Return files with their hashes.

    Raises
    ------
    InputError
        If a file cannot be read, or is not in that state, before or after it was hashed.
    """
    found = []
    for own in files:
        with read_errors(own.path), own.path.open("rb") as stream:
            opened = os.fstat(stream.fileno())
            digest = hashlib.file_digest(stream, "sha256").hexdigest()
            now = _state(own.path.parent, own.path.name)
        if now != own or (opened.st_dev, opened.st_ino) != own.state[:2]:
            raise InputError(f"{own.path}: was changed while it was read")
        found.append(HashedFile(own.name, own.size, digest))
    return tuple(found)
