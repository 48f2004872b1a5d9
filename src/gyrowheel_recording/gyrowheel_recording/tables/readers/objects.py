"""Objects of MATLAB, such as timetables and dates, which no other program can read."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

from gyrowheel_core.errors import InputError
from gyrowheel_recording.tables.grid import Column

#: How numbers come out of an object.
_CURES: Final = {
    "timetable": "s = table2struct(timetable2table(T), 'ToScalar', true); s.Time = seconds(T.Properties.RowTimes)",
    "table": "s = table2struct(T, 'ToScalar', true)",
    "datetime": "t = posixtime(t)",
    "duration": "t = seconds(t)",
    "timeseries": "s.time = ts.Time; s.data = ts.Data",
}
_OTHERWISE: Final = "save its numbers as plain vectors"


def said_of_objects(
    objects: Mapping[str, str], path: Path, columns: Sequence[Column], *, all_read: bool
) -> list[str]:
    """Return what is said of variables that are objects, by their names and classes.

    Raises
    ------
    InputError
        If there is nothing else in the file.
    """
    said = [
        f"{name} is an object of MATLAB, a {kind}, which MATLAB alone can read: {_CURES.get(kind, _OTHERWISE)}"
        for name, kind in objects.items()
    ]
    if said and all_read and not columns:
        raise InputError(f"{path}: has no columns of numbers: {'; '.join(said)}")
    return said if all_read else []
