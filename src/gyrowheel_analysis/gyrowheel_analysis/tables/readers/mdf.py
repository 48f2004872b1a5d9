"""MDF files of version 3 and 4, by asammdf: each group of channels has a clock of its own."""

from __future__ import annotations

import contextlib
import logging
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from gyrowheel_analysis.tables.grid import Column, Grid, require_table
from gyrowheel_analysis.tables.readers.optional import library
from gyrowheel_core.errors import InputError, one_line


def read(path: Path, names: Sequence[str] | None) -> Grid:
    """Read the channels by their names, and the clock of each group as ``time`` (see `formats.read_grid`)."""
    asammdf = library("asammdf", "mdf", path)
    logging.getLogger("asammdf").setLevel(logging.CRITICAL)  # it writes errors that are raised, too
    columns: list[Column] = []
    try:
        with contextlib.closing(asammdf.MDF(str(path))) as file:
            require_table(
                float(sum(group.channel_group.cycles_nr * len(group.channels) for group in file.groups)),
                str(path),
            )
            every = [channel.name for group in file.groups for channel in group.channels]
            repeated = {name for name, count in Counter(every).items() if count > 1}
            several = len(file.groups) > 1
            for g, group in enumerate(file.groups):
                if not group.channel_group.cycles_nr:
                    continue
                times = np.asarray(file.get_master(g), dtype=np.float64)
                clock = f"time {g + 1}" if several else "time"
                columns.append(Column(clock, times, "s", clock))
                master = file.masters_db.get(g)
                for k, channel in enumerate(group.channels):
                    if k == master:
                        continue
                    signal = file.get(group=g, index=k)
                    values = np.asarray(signal.samples)
                    if values.ndim != 1 or values.dtype.kind not in "biuf":
                        continue
                    name = f"{channel.name} {g + 1}" if channel.name in repeated else channel.name
                    columns.append(Column(name, values, str(signal.unit or ""), clock))
    except InputError:
        raise
    except Exception as error:  # the library raises its own and others of every kind
        raise InputError(f"{path}: cannot be read: {one_line(error)}") from None
    used = {own.clock for own in columns if names is None or own.name in names}
    return Grid.of(
        str(path), [own for own in columns if names is None or own.name in names or own.name in used]
    )
