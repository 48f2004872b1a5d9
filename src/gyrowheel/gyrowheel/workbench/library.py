"""The recordings of the chosen folders, and those that are open; no file outside these folders can be named."""

from __future__ import annotations

import os
import re
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

from gyrowheel.recordings.api import Recording
from gyrowheel.show.panels import columns
from gyrowheel.workbench.decimation import Envelope, envelopes
from gyrowheel_core.errors import InputError, nearest

_DEEPEST = 3  # folders below a chosen one that are searched
_MARK = "rosbag2_bagfile_information"
_METADATA = "metadata.yaml"
_HEAD = 4096  # characters of it that are looked at
_LENGTH = re.compile(r"\bduration:\s{0,20}\{?\s{0,20}nanoseconds:\s{0,20}(\d{1,18})\b")
_FRESH = 1.0  # s for which a listing of the folders stays valid


#: Use of a recording.
Role = Literal["fitted", "not used to fit"]
ROLES: tuple[Role, ...] = ("fitted", "not used to fit")


@dataclass(frozen=True)
class Opened:
    """An open recording: its use, and signals and setpoints ready to be drawn.

    `described` tells whether its summary is ready, which takes a moment for a long one.
    """

    key: str
    recording: Recording
    role: Role
    signals: Mapping[str, Envelope]
    setpoints: Mapping[str, Envelope]
    described: bool = False

    @classmethod
    def of(cls, key: str, recording: Recording, role: Role) -> Opened:
        """Return a recording with the data that the page asks for at once."""
        drawn = {name for name, _ in columns()}
        signals, setpoints = (envelopes(rows, drawn) for rows in (recording.measurement, recording.setpoints))
        _ = recording.time
        return cls(key, recording, role, signals, setpoints)

    def with_description(self) -> Opened:
        """Return it with its summary."""
        _ = self.recording.info
        return replace(self, described=True)


@dataclass(frozen=True)
class Entry:
    """A recording in a folder.

    Attributes
    ----------
    key : str
        Number of the chosen folder, and the path within it.
    path : Path
        Path.
    name : str
        Name of its directory.
    inside : str
        Subfolder of the chosen folder; with that folder, if there are several.
    size : int
        Size of its files [bytes].
    changed : float
        Time of the last change [s since 1970].
    duration : float or None
        Length in its metadata [s]; None if not stated.
    """

    key: str
    path: Path
    name: str
    inside: str
    size: int
    changed: float
    duration: float | None


class Library:
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
        self._looked: tuple[float, list[Entry]] | None = None

    @property
    def first(self) -> Path:
        """The folder for new recordings."""
        own = self._folders[0]
        return own.parent if _head(own) is not None else own

    def take(self, recording: Path) -> str:
        """Return the key of a new recording, which is listed from now on."""
        place = recording.resolve()
        for entry in self.entries():
            if entry.path == place:
                return entry.key
        self._folders.append(place)
        self._looked = None
        return f"{len(self._folders) - 1}/."

    def entries(self) -> list[Entry]:
        """Return the recordings, the latest first."""
        found: dict[Path, Entry] = {}
        for number, root in enumerate(self._folders):
            for path, head in _recordings(root, _DEEPEST):
                if path not in found:
                    found[path] = _entry(number, root, path, head, several=len(self._folders) > 1)
        latest_first = sorted(found.values(), key=lambda entry: -entry.changed)
        self._looked = time.monotonic(), latest_first
        return latest_first

    def listed(self) -> list[Entry]:
        """Return the recordings, at most a second old: pages ask many times a second during a job."""
        looked = self._looked
        return looked[1] if looked and time.monotonic() - looked[0] < _FRESH else self.entries()

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


def _recordings(folder: Path, depth: int) -> Iterator[tuple[Path, str]]:
    """Yield the recordings in a folder, each with the beginning of its metadata."""
    head = _head(folder)
    if head is not None:
        yield folder, head
        return
    if depth == 0:
        return
    try:
        inside = sorted(p for p in folder.iterdir() if p.is_dir() and not p.is_symlink() and p.name[0] != ".")
    except OSError:
        return
    for path in inside:
        yield from _recordings(path, depth - 1)


def _head(folder: Path) -> str | None:
    """Return the beginning of the metadata of a recording; None for any other folder."""
    file = folder / _METADATA
    try:
        if not file.is_file():  # opening a pipe would block
            return None
        with file.open(encoding="utf-8", errors="replace") as stream:
            head = stream.read(_HEAD)
    except OSError:
        return None
    return head if _MARK in head else None


def _entry(number: int, root: Path, path: Path, head: str, *, several: bool) -> Entry:
    size, changed = 0, 0.0
    try:
        files = list(path.iterdir())
    except OSError:
        files = []  # it was just removed, or is not readable: opening it reports that
    for file in files:
        try:
            state = file.stat()
        except OSError:
            continue
        size, changed = size + state.st_size, max(changed, state.st_mtime)
    within = path.relative_to(root)
    inside = within.parent
    if several:
        inside = Path(root.parent.name if path == root else root.name) / inside
    length = _LENGTH.search(head)
    return Entry(
        f"{number}/{_text(within.as_posix())}",
        path,
        _text(path.name),
        "" if inside == Path() else _text(inside.as_posix()),
        size,
        changed,
        1e-9 * int(length[1]) if length else None,
    )


def _text(name: str) -> str:
    """Return a name as valid text: other bytes become escapes."""
    return os.fsencode(name).decode("utf-8", "backslashreplace")
