"""Signals of a running bench as they arrive: the extremes of short bins, the latest of a limited number."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from typing import Any

import numpy as np

from gyrowheel.show.figure import columns
from gyrowheel_core import wire

BIN_NS = 10_000_000  #: length of a bin [ns]
KEPT = 6000  #: number of bins: a minute
_SIGNALS, _SIZES = zip(*columns(), strict=True)
#: Of a row: smallest and largest value of each signal, then the setpoints.
ROW = (*(f"low {name}" for name in _SIGNALS), *(f"high {name}" for name in _SIGNALS))
SETPOINTS = ("tilt_x", "tilt_y", "spin_rate")
_SETPOINT_SIZES = [dict(columns())[name] for name in SETPOINTS]
_COUNT = len(_SIGNALS)
_AGAIN = 100  # bins back in time at which a bench has begun again


class Trace:
    """The latest minute of the signals of a bench, in bins, in a ring of fixed size; for any number of threads."""

    def __init__(self) -> None:
        self._rows = np.full((KEPT, 2 * _COUNT), np.nan)
        self._setpoints = np.full((KEPT, len(SETPOINTS)), np.nan)
        #: Numbers of the bins in the ring: of the signals, and of the setpoints, which arrive ahead of their time.
        self._numbers, self._asked = (np.full(KEPT, -1) for _ in range(2))
        self._first, self._latest = 0, -1
        self._lock = threading.Lock()

    def set(self, stamp_ns: int, *setpoint: float) -> None:
        """Add the setpoint of a time [ns]: tilts [rad] and spin rate [rad/s]."""
        number = stamp_ns // BIN_NS
        with self._lock:
            self._asked[number % KEPT] = number
            self._setpoints[number % KEPT] = np.divide(setpoint, _SETPOINT_SIZES)

    def take(self, messages: Sequence[bytes]) -> None:
        """Add serialized measurements; those of other layouts are passed over."""
        layout = wire.MEASUREMENT
        found = np.frombuffer(b"".join(m for m in messages if len(m) == layout.size), layout.dtype)
        found = found[layout.matches(found)]
        if not len(found):
            return
        bins = layout.stamps(found) // BIN_NS
        values = np.column_stack([found[name] for name in _SIGNALS]) / _SIZES
        begins = np.flatnonzero(np.diff(bins, prepend=bins[0] - 1))
        lows, highs = (of.reduceat(values, begins) for of in (np.fmin, np.fmax))
        with self._lock:
            for number, low, high in zip(bins[begins].tolist(), lows, highs, strict=True):
                self._put(number, low, high)

    def _put(self, number: int, low: Any, high: Any) -> None:
        if self._latest < 0 or number < self._latest - _AGAIN:
            self._first, self._latest = number, -1
        row, place = self._rows[number % KEPT], number % KEPT
        if self._numbers[place] != number:
            self._numbers[place] = number
            row[:] = np.nan
        row[:_COUNT] = np.fmin(row[:_COUNT], low)
        row[_COUNT:] = np.fmax(row[_COUNT:], high)
        self._latest = max(self._latest, number)

    def latest(self) -> tuple[float, ...] | None:
        """Return the latest readings of what setpoints are of, in the units of `ROW`; None without one."""
        with self._lock:
            if self._latest < 0:
                return None
            row = self._rows[self._latest % KEPT]
            found = tuple(float(row[ROW.index(f"low {name}")]) for name in SETPOINTS)
        return found if np.isfinite(found).all() else None

    def since(self, number: int) -> dict[str, Any]:
        """Return the complete bins from a number on; all that are kept if that one is not among them.

        ``first`` is the number of the first row, ``next`` that to ask with next; what is missing is null.
        """
        with self._lock:
            end = max(self._latest, self._first)
            oldest = max(end - KEPT + 1, self._first)
            first = number if oldest <= number <= end else oldest
            numbers = np.arange(first, end)
            places = numbers % KEPT
            signals = np.where((self._numbers[places] == numbers)[:, None], self._rows[places], np.nan)
            asked = np.where((self._asked[places] == numbers)[:, None], self._setpoints[places], np.nan)
        whole = np.hstack([signals, asked]).round(5).tolist()
        rows = [[None if own != own else own for own in row] for row in whole]
        return {"first": first, "next": end, "rows": rows}
