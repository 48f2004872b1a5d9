"""Text of LabVIEW (``.lvm``): heads that state separators, units, and when each channel begins, with its step."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from gyrowheel_core.errors import InputError
from gyrowheel_recording.tables.grid import Column, Grid
from gyrowheel_recording.tables.readers.text_table import rows_of
from gyrowheel_recording.tables.text import TextForm, cells_of, lines_of, one_byte_encoding, text_of

Array = NDArray[np.float64]

MAGIC: Final = b"LabVIEW Measurement"
_END: Final = "***End_of_Header***"
_SPECIAL: Final = ("***Start_Special***", "***End_Special***")
_X: Final = "X_Value"
_COMMENT: Final = "Comment"


@dataclass(frozen=True)
class _Segment:
    """A head of channels with the rows below it."""

    head: Mapping[str, Sequence[str]]  # cells of the lines of the head, by what stands first in them
    names: Sequence[str]  # of all columns, those of times included
    rows: Sequence[str]
    number: int  # of the line of the first row, from 1 on

    def of(self, key: str, column: int) -> str:
        """Return what the head states for a column; empty where it states nothing."""
        cells = self.head.get(key, ())
        return cells[column] if column < len(cells) else ""

    def number_of(self, key: str, column: int, decimal: str) -> float:
        """Return a number that the head states for a column; NaN where it states none."""
        try:
            return float(self.of(key, column).replace(decimal, "."))
        except ValueError:
            return float("nan")


def read(path: Path, names: Sequence[str] | None) -> Grid:
    """Read channels by their names, their times as ``X_Value`` (see `formats.read_grid`)."""
    data = text_of(path)
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = data.decode(one_byte_encoding(data))
    lines = lines_of(text)
    if not any(line.startswith(_END) for line in lines):
        raise InputError(f"{path}: damaged: its head has no end, a line {_END}")
    tabs = b"\t" in data[: data.find(b"\n")] or b"Separator\tTab" in data
    head, begin = _head(lines, 0, "\t" if tabs else ",")
    delimiter = "," if head.get("Separator", ["", "Tab"])[1:2] == ["Comma"] else "\t"
    decimal = (head.get("Decimal_Separator", [])[1:2] or ["."])[0] or "."
    channels = _Channels(str(path), head, delimiter, decimal)
    for segment in _segments(lines, begin, delimiter):
        channels.add(segment)
    return channels.grid(names)


class _Channels:
    """The channels of a file, segment by segment, by the number and the name of their column."""

    def __init__(self, path: str, head: Mapping[str, Sequence[str]], delimiter: str, decimal: str) -> None:
        self._path, self._head, self._delimiter, self._decimal = path, head, delimiter, decimal
        self._values: dict[tuple[int, str], list[Array]] = {}
        self._times: dict[tuple[int, str], list[Array]] = {}
        self._units: dict[tuple[int, str], str] = {}
        self._remarks: list[str] = []
        self._start: Any = None

    def add(self, segment: _Segment) -> None:
        """Add the rows of a segment."""
        width = tuple(f"{k}" for k in range(len(segment.names)))
        form = TextForm(self._delimiter, self._decimal, names=width, named=False)
        rows = "\n".join(_padded(segment, self._delimiter)).encode() + b"\n"
        columns = rows_of(rows, form, self._path).columns
        cells = {int(name): column.values for name, column in columns.items() if column.numeric}
        for k, name in enumerate(segment.names):
            if name in (_X, _COMMENT) or k not in cells or not np.isfinite(cells[k]).any():
                continue
            dimension = segment.of("X_Dimension", k)
            if dimension in ("", "Time"):
                self._add(segment, k, cells)
            else:
                self._remarks.append(f"{name} is over {dimension}, not over time: left out")

    def _add(self, segment: _Segment, k: int, cells: Mapping[int, Any]) -> None:
        """Add the values of a column of a segment, and their times where these are known."""
        key = k, segment.names[k]
        count = segment.number_of("Samples", k, self._decimal)
        own = np.asarray(cells[k], dtype=np.float64)[: int(count) if count > 0 else None]
        begun = _date(segment, k) or _date_of(self._head)
        self._start = begun if self._start is None else self._start
        known = begun and self._start
        late = float((begun - self._start) / np.timedelta64(1, "ns")) * 1e-9 if known else 0.0
        times = _times(segment, k, cells, len(own), self._decimal)
        if times is not None:
            self._times.setdefault(key, []).append(times + late)
        self._values.setdefault(key, []).append(own)
        self._units.setdefault(key, segment.of("Y_Unit_Label", k))

    def grid(self, names: Sequence[str] | None) -> Grid:
        """Return the wanted channels with their times."""
        columns: list[Column] = []
        clocks: dict[bytes, str] = {}
        for key, parts in self._values.items():
            clock, name = "", key[1]
            if len(self._times.get(key, [])) == len(parts):
                own = np.concatenate(self._times[key])
                clock = clocks.setdefault(own.tobytes(), _X if not clocks else f"{_X} {name}")
                if all(column.name != clock for column in columns):
                    columns.append(Column(clock, own, "s", clock))
            columns.append(Column(name, np.concatenate(parts), self._units[key], clock))
        wanted = {own.name for own in columns if names is None or own.name in names}
        wanted |= {own.clock for own in columns if own.name in wanted}
        return Grid.of(self._path, [own for own in columns if own.name in wanted], self._remarks)


def _head(lines: Sequence[str], begin: int, delimiter: str) -> tuple[dict[str, list[str]], int]:
    """Return the cells of a head, and the number of the line behind it."""
    found: dict[str, list[str]] = {}
    for k in range(begin, len(lines)):
        cells = cells_of(lines[k], delimiter)
        if cells[0] == _END:
            return found, k + 1
        found.setdefault(cells[0], cells)
    return found, len(lines)


def _segments(lines: Sequence[str], begin: int, delimiter: str) -> Iterator[_Segment]:
    """Yield the segments of a file."""
    at = begin
    while at < len(lines):
        first = lines[at].partition(delimiter)[0].strip()
        if first == _SPECIAL[0]:
            at = next((k for k in range(at, len(lines)) if lines[k].startswith(_SPECIAL[1])), len(lines)) + 1
        elif not first and not lines[at].strip(f"{delimiter} "):
            at += 1
        else:
            head, at = _head(lines, at, delimiter)
            names = cells_of(lines[at], delimiter) if at < len(lines) else []
            end = next(
                (
                    k
                    for k in range(at + 1, len(lines))
                    if not lines[k].strip() or lines[k].startswith("Channels")
                ),
                len(lines),
            )
            yield _Segment(head, names, lines[at + 1 : end], at + 2)
            at = end


def _padded(segment: _Segment, delimiter: str) -> list[str]:
    """Return the rows with as many cells as there are names: empty ones at the end may be left out."""
    width = len(segment.names) - 1
    return [line + delimiter * max(width - line.count(delimiter), 0) for line in segment.rows]


def _times(segment: _Segment, column: int, cells: Mapping[int, Any], rows: int, decimal: str) -> Array | None:
    """Return the times of a channel [s]: those of the nearest column of times before it, or by start and step."""
    at = max((k for k in range(column) if segment.names[k] == _X), default=-1)
    if at in cells and np.isfinite(cells[at][:rows]).all():
        return np.asarray(cells[at][:rows], dtype=np.float64)
    step, first = (segment.number_of(key, column, decimal) for key in ("Delta_X", "X0"))
    if not step > 0.0:
        return None
    return np.asarray((first if np.isfinite(first) else 0.0) + step * np.arange(rows))


_DATE: Final = re.compile(r"(\d{4})[/-](\d\d)[/-](\d\d) (\d\d):(\d\d):(\d\d)(?:[.,](\d{1,9}))?")


def _date(segment: _Segment, column: int) -> Any:
    return _as_date(segment.of("Date", column), segment.of("Time", column))


def _date_of(head: Mapping[str, Sequence[str]]) -> Any:
    return _as_date(*("".join(head.get(key, ())[1:2]) for key in ("Date", "Time")))


def _as_date(date: str, time: str) -> Any:
    """Return when something began; None where that is not stated."""
    found = _DATE.match(f"{date} {time}")
    if not found:
        return None
    year, month, day, hour, minute, second, part = found.groups()
    try:
        return np.datetime64(
            f"{year}-{month}-{day}T{hour}:{minute}:{second}.{(part or '0').ljust(9, '0')}", "ns"
        )
    except ValueError:
        return None
