"""TDMS files, by npTDMS: each group has a clock of its own where its channels are waveforms."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from gyrowheel_recording.tables.grid import Column, Grid, require_table
from gyrowheel_recording.tables.readers import library, library_errors

_NS: Final = 1e-9


def read(path: Path, names: Sequence[str] | None) -> Grid:
    """Read channels as ``group/channel``, the times of waveforms as ``group/time`` (see `formats.read_grid`)."""
    nptdms = library("nptdms", "tdms", path)
    columns: list[Column] = []
    clocks: dict[tuple[Any, ...], str] = {}
    remarks: list[str] = []
    # opened here, and below: of a path npTDMS takes what an index file next to it says, be it of another recording
    with library_errors(path), path.open("rb") as opened, nptdms.TdmsFile.open(opened) as file:
        channels = []
        size = 0.0
        for group in file.groups():
            for channel in group.channels():
                if len(channel) and channel.dtype.kind in "biufM":  # texts are not read
                    channels.append(channel)
                    size += len(channel) * max(channel.dtype.itemsize / 8.0, 1.0)
        require_table(size, str(path))
        if file.file_status.incomplete_final_segment:
            remarks.append("the file breaks off: its last segment is read as far as it goes")
        parts = _parts(nptdms, path)
        starts = [
            own.start for channel in channels for own in parts.get(channel.path, []) if own.start is not None
        ]
        begin = min(starts, default=None)
        for channel in channels:
            values = np.asarray(channel[:])
            if values.dtype.kind not in "biufM":
                continue
            own, clock = channel.properties, ""
            axis = str(own.get("wf_xunit_string", ""))
            if axis not in _SECONDS:
                remarks.append(f"{channel.group_name}/{channel.name} is over {axis}, not over time: left out")
                continue
            pieces = tuple(part.timed(begin) for part in _joined(parts.get(channel.path, []), begin))
            if pieces:
                key = pieces, len(values)
                if key not in clocks:
                    clock = f"{channel.group_name}/time"
                    taken = list(clocks.values()).count(clock) + sum(c.name == clock for c in columns)
                    clock = clock if not taken else f"{channel.group_name}/{channel.name}/time"
                    clocks[key] = clock
                    columns.append(Column(clock, _times(pieces, len(values)), "s", clock))
                clock = clocks[key]
            unit = str(own.get("unit_string", own.get("NI_UnitDescription", "")))
            columns.append(Column(f"{channel.group_name}/{channel.name}", values, unit, clock))
    used = {own.clock for own in columns if names is None or own.name in names}
    found = [own for own in columns if names is None or own.name in names or own.name in used]
    return Grid.of(str(path), found, remarks)


#: Units of the axis of a waveform over time.
_SECONDS: Final = ("", "s", "sec", "second", "seconds", "Time", "time")
_CONTINUES: Final = 1.5  # steps by which a segment may seem to begin early or late, and goes on without a gap


class _Part(NamedTuple):
    """Values of a waveform from one start on, as the segments of a file state it."""

    row: int  # number of the first of them
    start: Any  # date of the start; None where none is stated
    offset: float  # time of the first one from the start on, and the time between two [s]
    step: float

    def timed(self, begin: Any) -> tuple[int, float, float]:
        """Return row, time of the first value from a date on, and step [s]."""
        late = (
            0.0
            if self.start is None
            else float((self.start - begin).astype("timedelta64[ns]").astype(np.int64))
        )
        return self.row, self.offset + late * _NS, self.step


def _parts(nptdms: Any, path: Path) -> dict[str, list[_Part]]:
    """Return the parts of every waveform: npTDMS keeps what the last segment states, and others may state another."""
    found: dict[str, list[_Part]] = {}

    class Reader(nptdms.reader.TdmsReader):
        """Notes what a segment states before its values count."""

        def _update_object_metadata(self, segment: Any) -> None:
            self.before = {name: own.num_values for name, own in self.object_metadata.items()}
            super()._update_object_metadata(segment)

        def _update_object_properties(self, stated: Any) -> None:
            super()._update_object_properties(stated)
            for name, properties in (stated or {}).items():
                if not any(key.startswith("wf_") for key, _ in properties):
                    continue
                own = self.object_metadata[name].properties
                step = float(own.get("wf_increment", 0.0))
                if step > 0.0:
                    start = own.get("wf_start_time")
                    if start is not None:
                        raw = hasattr(start, "as_datetime64")
                        start = start.as_datetime64("ns") if raw else np.datetime64(start, "ns")
                    part = _Part(
                        self.before.get(name, 0), start, float(own.get("wf_start_offset", 0.0)), step
                    )
                    several = found.setdefault(name, [])
                    if not several or several[-1][1:] != part[1:]:
                        several.append(part)

    with path.open("rb") as opened:
        Reader(opened).read_metadata()
    return found


def _joined(parts: Sequence[_Part], begin: Any) -> list[_Part]:
    """Return the parts without those that go on where the one before ends."""
    result: list[_Part] = []
    for part in parts:
        if result and part.step == result[-1].step:
            (row, first, step), (own_row, own_first, _) = result[-1].timed(begin), part.timed(begin)
            if abs(own_first - first - step * (own_row - row)) < _CONTINUES * step:
                continue
        if result and result[-1].row == part.row:
            result.pop()  # nothing stood between the two
        result.append(part)
    return result


def _times(parts: Sequence[tuple[int, float, float]], rows: int) -> Any:
    """Return the times of values [s]."""
    number = np.arange(rows)
    result = np.zeros(rows)
    for row, first, step in parts:
        result[row:] = first + step * (number[row:] - row)
    return result
