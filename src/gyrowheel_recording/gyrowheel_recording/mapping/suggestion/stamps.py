"""Times that stand in two columns: whole seconds, and the part of the second."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import Final

import numpy as np

from gyrowheel_recording.tables import Column, Grid

#: Names of columns with the part of a second: what it is called, in which unit, and how many make a second.
_PARTS: Final = (
    (re.compile(r"(.*?)(nano_?sec(?:ond)?s?|nsecs?|ns)", re.IGNORECASE), "ns", 1_000_000_000),
    (re.compile(r"(.*?)(micro_?sec(?:ond)?s?|usecs?|us)", re.IGNORECASE), "us", 1_000_000),
    (re.compile(r"(.*?)(milli_?sec(?:ond)?s?|msecs?|ms)", re.IGNORECASE), "ms", 1000),
)
_SECONDS: Final = ("sec", "secs", "second", "seconds", "s")
_BRACKETS: Final = re.compile(r"\s*[\[(].*?[\])]\s*$")


def with_stamps(grid: Grid) -> tuple[Grid, dict[str, tuple[str, str, str]]]:
    """Return a table in which seconds and their part are one column, and what that column consists of.

    The result has, by the name of the new column, those of the two and the unit of the second one; of several such
    pairs the first one is taken.
    """
    plain = {_BRACKETS.sub("", name).lower(): name for name in grid.columns}
    for short, name in plain.items():
        for pattern, unit, a_second in _PARTS:
            found = pattern.fullmatch(short)
            whole = found and next((plain[found[1] + own] for own in _SECONDS if found[1] + own in plain), "")
            if not whole or not _fit(grid.columns[whole], grid.columns[name], a_second):
                continue
            seconds, part = (np.asarray(grid.columns[own].values, dtype=np.int64) for own in (whole, name))
            joined = f"{whole} + {name}"
            nanoseconds = seconds * 1_000_000_000 + part * (1_000_000_000 // a_second)
            columns = {own: column for own, column in grid.columns.items() if own not in (whole, name)}
            stamp = Column(joined, nanoseconds, "ns", grid.columns[whole].clock)
            return replace(grid, columns={joined: stamp, **columns}), {joined: (whole, name, unit)}
    return grid, {}


def _fit(seconds: Column, part: Column, a_second: int) -> bool:
    """Whether two columns are whole seconds and the part of each."""
    if (
        not (seconds.numeric and part.numeric)
        or len(seconds.values) != len(part.values)
        or len(part.values) < 2
    ):
        return False
    one, other = (np.asarray(own.values, dtype=np.float64) for own in (seconds, part))
    if not (np.isfinite(one).all() and np.isfinite(other).all()):
        return False
    whole = bool(
        np.all(one == np.round(one)) and np.all(other == np.round(other)) and np.abs(one).max() < 9e9
    )
    return whole and bool(
        other.min() >= 0.0 and other.max() < a_second and np.median(np.abs(np.diff(one))) <= 1.0
    )
