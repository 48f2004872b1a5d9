"""The recordings in the folders that a user chose; nothing outside of these can be named."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from gyrowheel_core.errors import InputError, nearest

_DEEPEST = 3  # folders below a chosen one that are searched
_MOST = 500  # recordings that are listed
_MARK = "rosbag2_bagfile_information"
_METADATA = "metadata.yaml"


@dataclass(frozen=True)
class Entry:
    """A recording in a folder.

    Attributes
    ----------
    key : str
        What it is asked for by: the number of the chosen folder, and its path within.
    path : Path
        Where it is.
    name : str
        Name of its directory.
    size : int
        Of its files [bytes].
    changed : float
        When it was last changed [s since 1970].
    """

    key: str
    path: Path
    name: str
    size: int
    changed: float


class Shelf:
    """The recordings of some folders.

    Parameters
    ----------
    folders : sequence of Path
        Folders, or recordings themselves.

    Raises
    ------
    InputError
        If a folder does not exist.
    """

    def __init__(self, folders: Sequence[Path]) -> None:
        for folder in folders:
            if not folder.is_dir():
                raise InputError(f"{folder}: no such folder")
        self._folders = [folder.resolve() for folder in folders]

    @property
    def first(self) -> Path:
        """The folder for what is new."""
        own = self._folders[0]
        return own.parent if _is_recording(own) else own

    def take(self, recording: Path) -> str:
        """Return the key of a recording that was made here; it is on the shelf from now on."""
        place = recording.resolve()
        for entry in self.entries():
            if entry.path == place:
                return entry.key
        self._folders.append(place)
        return f"{len(self._folders) - 1}/."

    def entries(self) -> list[Entry]:
        """Return the recordings, the latest first."""
        found: dict[Path, Entry] = {}
        for number, root in enumerate(self._folders):
            for path in _recordings(root, _DEEPEST):
                if path not in found and len(found) < _MOST:
                    inside = path.relative_to(root).as_posix()
                    found[path] = _entry(f"{number}/{inside}", path)
        return sorted(found.values(), key=lambda entry: -entry.changed)

    def find(self, key: str) -> Entry:
        """Return a recording by its key.

        Raises
        ------
        InputError
            If no such recording is in the folders.
        """
        known = {entry.key: entry for entry in self.entries()}
        if key not in known:
            raise InputError(f"recording {key!r}: not in the chosen folders; {nearest(key, known)}")
        return known[key]


def _recordings(folder: Path, depth: int) -> Iterator[Path]:
    if _is_recording(folder):
        yield folder
        return
    if depth == 0:
        return
    try:
        inside = sorted(p for p in folder.iterdir() if p.is_dir() and not p.is_symlink() and p.name[0] != ".")
    except OSError:
        return
    for path in inside:
        yield from _recordings(path, depth - 1)


def _is_recording(folder: Path) -> bool:
    try:
        with (folder / _METADATA).open(encoding="utf-8", errors="replace") as stream:
            return _MARK in stream.read(4096)
    except OSError:
        return False


def _entry(key: str, path: Path) -> Entry:
    size, changed = 0, 0.0
    for file in path.iterdir():
        try:
            state = file.stat()
        except OSError:
            continue
        size, changed = size + state.st_size, max(changed, state.st_mtime)
    return Entry(key, path, path.name, size, changed)
