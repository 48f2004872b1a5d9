"""The recordings of the chosen folders, and those that are open, with their signals ready to be drawn."""

from __future__ import annotations

import math
import os
import re
import time
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from gyrowheel.recordings.api import Recording
from gyrowheel.show.figure import columns
from gyrowheel.show.files import bag_head
from gyrowheel_core.arrays import block_extremes, by_blocks
from gyrowheel_core.errors import InputError, nearest
from gyrowheel_recording.bags import being_written
from gyrowheel_recording.bags.reader import SPAN

_BLOCK = SPAN  # samples per stored pair of extremes; `by_blocks` uses a multiple of it
_DIRECT = 2 * _BLOCK  # samples of an interval from which on the extremes of blocks are used

Array = NDArray[np.float64]
_DEEPEST = 3  # folders below a chosen one that are searched
_LENGTH = re.compile(r"\bduration:\s{0,20}\{?\s{0,20}nanoseconds:\s{0,20}(\d{1,18})\b")
_FRESH = 1.0  # s for which a listing of the folders stays valid
#: Use of a recording.
Role = Literal["fitted", "not used to fit"]
ROLES: tuple[Role, ...] = ("fitted", "not used to fit")
#: Use of a range of a recording.
Use = Literal["fitted", "not used to fit", "left out"]
USES: tuple[Use, ...] = (*ROLES, "left out")


@dataclass(frozen=True)
class Range:
    """A range of a recording [s from its start] and its use."""

    begin: float
    end: float
    use: Use


def with_range(ranges: Sequence[Range], new: Range) -> tuple[Range, ...]:
    """Return ranges in order of time with another one, which takes the place of what it covers."""
    left = [
        part
        for own in ranges
        for part in (
            replace(own, end=min(own.end, new.begin)),
            replace(own, begin=max(own.begin, new.end)),
        )
        if part.begin < part.end
    ]
    joined: list[Range] = []
    for own in sorted([*left, new], key=lambda part: part.begin):
        if joined and joined[-1].use == own.use and joined[-1].end == own.begin:
            joined[-1] = replace(joined[-1], end=own.end)
        else:
            joined.append(own)
    return tuple(joined)


class Envelope:
    """A signal with the extremes of its blocks, from which any part is drawn without delay; NaN is ignored."""

    def __init__(self, values: Array, extremes: tuple[Array, Array] | None = None) -> None:
        self.values = values
        self._low, self._high = extremes or _extremes([values], len(values))[0]

    def cut(self, first: int, last: int, points: int) -> tuple[Array, Array]:
        """Return the samples from `first` to before `last` as a line of at most `points` points, 4 or more.

        Positions [samples] and values, shape (m,): the samples themselves if they are few, else smallest and largest
        value of every interval, at its beginning and its middle. Positions depend on the arguments alone.
        """
        first, last = max(first, 0), min(last, len(self.values))
        count = last - first
        if count <= points:
            return np.arange(first, max(last, first), dtype=np.float64), self.values[first : max(last, first)]
        buckets = points // 2
        unit, low, high = 1, self.values, self.values
        if count >= buckets * _DIRECT:
            unit, low, high = _BLOCK, self._low, self._high
            first, last = first // unit, -(-last // unit)
        edges = np.linspace(first, last, buckets + 1).astype(np.int64)
        ends = np.stack(
            [np.fmin.reduceat(low[:last], edges[:-1]), np.fmax.reduceat(high[:last], edges[:-1])], axis=1
        )
        width = np.diff(edges)
        places = np.stack([edges[:-1], edges[:-1] + 0.5 * width], axis=1) * float(unit)
        return places.ravel(), ends.ravel()


def envelopes(rows: NDArray[Any], wanted: Collection[str]) -> dict[str, Envelope]:
    """Return some columns as signals; one pass finds the extremes of all."""
    names = [name for name in rows.dtype.names or () if name in wanted]
    columns = [rows[name] for name in names]
    found = _extremes(columns, len(rows))
    return {name: Envelope(rows[name], own) for name, own in zip(names, found, strict=True)}


def _extremes(columns: Sequence[Array], count: int) -> list[tuple[Array, Array]]:
    """Return smallest and largest value of every block of each column."""
    found = [(np.empty(-(-count // _BLOCK)), np.empty(-(-count // _BLOCK))) for _ in columns]

    def look(first: int, last: int) -> None:
        to = slice(first // _BLOCK, -(-last // _BLOCK))
        for column, ends in zip(columns, found, strict=True):
            part = np.ascontiguousarray(column[first:last])
            quick = block_extremes(part[None], _BLOCK)[0]
            for careful, values, out in zip((np.fmin, np.fmax), quick, ends, strict=True):
                out[to] = values
                # NaN is ignored, which is slower
                for k in np.flatnonzero(np.isnan(values)):
                    out[to][k] = careful.reduce(part[k * _BLOCK : (k + 1) * _BLOCK])

    by_blocks(count, look)
    return found


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
    parts: dict[Range, Recording] = field(default_factory=dict, compare=False)  # as they were cut

    def uses(self, ranges: Sequence[Range] = ()) -> tuple[Range, ...]:
        """Return the uses of the whole recording in order of time, with some ranges; the rest has its role."""
        uses: tuple[Range, ...] = (Range(-math.inf, math.inf, self.role),)
        for own in ranges:
            uses = with_range(uses, own)
        return uses

    def of_use(self, use: Use, ranges: Sequence[Range]) -> list[Recording]:
        """Return the parts of a use, each as a recording."""
        found = []
        for own in self.uses(ranges):
            if own.use == use and own not in self.parts:
                whole = own.begin == -math.inf and own.end == math.inf
                self.parts[own] = self.recording if whole else self.recording.part(own.begin, own.end)
            if own.use == use:
                found.append(self.parts[own])
        return found

    @classmethod
    def of(cls, key: str, recording: Recording, role: Role) -> Opened:
        """Return a recording with the data that the page asks for at once."""
        drawn = {name for name, _ in columns()}
        rows, known = recording.measurement, recording.data.extremes
        signals = {
            name: Envelope(rows[name], (known[name][0], known[name][1])) for name in drawn & known.keys()
        }
        signals = signals or envelopes(rows, drawn)
        setpoints = envelopes(recording.setpoints, drawn)
        _ = recording.time
        return cls(key, recording, role, signals, setpoints)

    def with_description(self) -> Opened:
        """Return it with its summary."""
        _ = self.recording.info
        return replace(self, described=True)


@dataclass(frozen=True)
class Entry:
    """A recording in a folder."""

    key: str  # number of the chosen folder, and the path within it
    path: Path
    name: str  # of its directory
    inside: str  # subfolder of the chosen folder; with that folder, if there are several
    size: int  # of its files [bytes]
    changed: float  # time of the last change [s since 1970]
    duration: float | None  # in its metadata [s]
    growing: bool  # whether it is being written now


class Library:
    """The recordings of some folders, or recordings themselves; InputError if a folder does not exist."""

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
        return own.parent if bag_head(own) is not None else own

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
        """Return a recording by its key; InputError for a key that is not in the folders."""
        known = {entry.key: entry for entry in self.entries()}
        if key not in known:
            raise InputError(f"recording {key!r}: not in the chosen folders; {nearest(key, known)}")
        return known[key]


def _recordings(folder: Path, depth: int) -> Iterator[tuple[Path, str]]:
    """Yield the recordings in a folder, each with the beginning of its metadata: empty while it is being written."""
    head = bag_head(folder)
    if head is None and being_written(folder):
        head = ""
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
        growing=not head,
    )


def _text(name: str) -> str:
    """Return a name as valid text: other bytes become escapes."""
    return os.fsencode(name).decode("utf-8", "backslashreplace")
