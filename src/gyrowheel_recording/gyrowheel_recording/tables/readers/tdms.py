"""TDMS files, by npTDMS: each group has a clock of its own where its channels are waveforms."""

from __future__ import annotations

import logging
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from gyrowheel_core.errors import InputError
from gyrowheel_recording.tables.grid import Column, Grid, require_table
from gyrowheel_recording.tables.readers import library, library_errors

_NS: Final = 1e-9
_SCALES: Final = re.compile(r"NI_Scale\[(\d+)\]")
_MOST_SCALES: Final = 1000  # of a channel


def read(path: Path, names: Sequence[str] | None) -> Grid:
    """Read channels as ``group/channel``, the times of waveforms as ``group/time`` (see `formats.read_grid`)."""
    nptdms = library("nptdms", "tdms", path)
    nptdms.log.log_manager.set_level(logging.CRITICAL)  # its warnings are reported below
    columns: list[Column] = []
    clocks: dict[tuple[float, float, int], str] = {}
    remarks: list[str] = []
    with library_errors(path), nptdms.TdmsFile.open(path) as file:
        _require_scales(file.properties, path)
        channels = []
        size = 0.0
        for group in file.groups():
            _require_scales(group.properties, path)
            for channel in group.channels():
                _require_scales(channel.properties, path)
                if len(channel) and channel.dtype.kind in "biufM":  # texts are not read
                    channels.append(channel)
                    size += len(channel) * max(channel.dtype.itemsize / 8.0, 1.0)
        require_table(size, str(path))
        if file.file_status.incomplete_final_segment:
            remarks.append("the file breaks off: its last segment is read as far as it goes")
        starts = [c.properties["wf_start_time"] for c in channels if "wf_start_time" in c.properties]
        begin = min((np.datetime64(start) for start in starts), default=None)
        for channel in channels:
            values = np.asarray(channel[:])
            if values.dtype.kind not in "biufM":
                continue
            own, clock = channel.properties, ""
            if float(own.get("wf_increment", 0.0)) > 0.0:
                first = float(own.get("wf_start_offset", 0.0))
                if "wf_start_time" in own and begin is not None:
                    late = np.timedelta64(np.datetime64(own["wf_start_time"]) - begin, "ns")
                    first += float(late.astype(np.int64)) * _NS
                key = (first, float(own["wf_increment"]), len(values))
                if key not in clocks:
                    clock = f"{channel.group_name}/time"
                    taken = list(clocks.values()).count(clock) + sum(c.name == clock for c in columns)
                    clock = clock if not taken else f"{channel.group_name}/{channel.name}/time"
                    clocks[key] = clock
                    columns.append(Column(clock, first + key[1] * np.arange(len(values)), "s", clock))
                clock = clocks[key]
            unit = str(own.get("unit_string", own.get("NI_UnitDescription", "")))
            columns.append(Column(f"{channel.group_name}/{channel.name}", values, unit, clock))
    used = {own.clock for own in columns if names is None or own.name in names}
    found = [own for own in columns if names is None or own.name in names or own.name in used]
    return Grid.of(str(path), found, remarks)


def _require_scales(properties: Mapping[str, Any], path: Path) -> None:
    """Refuse more scales than a channel may have: npTDMS makes room for as many as are stated."""
    found = [_SCALES.match(name) for name in properties]
    most = max((int(own[1]) + 1 for own in found if own), default=0)
    most = max(most, int(properties.get("NI_Number_Of_Scales", 0)))
    if most > _MOST_SCALES:
        raise InputError(f"{path}: damaged: a channel of {most} scales")
