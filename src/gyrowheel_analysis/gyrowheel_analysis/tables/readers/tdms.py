"""TDMS files, by npTDMS: each group has a clock of its own where its channels are waveforms."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from gyrowheel_analysis.tables.grid import Column, Grid, require_table
from gyrowheel_analysis.tables.readers.optional import library
from gyrowheel_core.errors import InputError, one_line

_NS = 1e-9


def read(path: Path, names: Sequence[str] | None) -> Grid:
    """Read channels as ``group/channel``, the times of waveforms as ``group/time`` (see `formats.read_grid`)."""
    nptdms = library("nptdms", "tdms", path)
    columns: list[Column] = []
    clocks: dict[tuple[float, float, int], str] = {}
    try:
        with nptdms.TdmsFile.open(path) as file:
            channels = [channel for group in file.groups() for channel in group.channels() if len(channel)]
            require_table(float(sum(len(channel) for channel in channels)), str(path))
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
    except InputError:
        raise
    except (OSError, ValueError, KeyError, TypeError, IndexError, EOFError) as error:
        raise InputError(f"{path}: cannot be read: {one_line(error)}") from None
    used = {own.clock for own in columns if names is None or own.name in names}
    return Grid.of(
        str(path), [own for own in columns if names is None or own.name in names or own.name in used]
    )
