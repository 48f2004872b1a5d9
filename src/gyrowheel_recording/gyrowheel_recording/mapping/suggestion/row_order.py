"""The order of the rows of a table: times that go back, restart, repeat, or belong to a counter."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from gyrowheel_recording.mapping.clock import rounded_to
from gyrowheel_recording.mapping.suggestion import SOME, Problem

Array = NDArray[np.float64]

_BESIDE: Final = 20  # rows that are compared at a place where times go back
_PLACES: Final = 100  # at most that are compared
_CLEAR_STEPS: Final = 6.0  # robust standard deviations of the steps, as for the clock of an import
#: Ranges of counters, of ticks of a unit or of a thousandth, a millionth or a billionth of it, and of clocks.
_RANGES: Final = tuple(2.0**k for k in (8, 12, 15, 16, 24, 31, 32))
_COUNTERS: Final = (
    *_RANGES, *(own * part for own in _RANGES for part in (1e-3, 1e-6, 1e-9)),
    *(own * ticks for own in (60.0, 3600.0, 86400.0) for ticks in (1.0, 1e3, 1e6, 1e9)), 1e3, 1e5, 1e6, 1e9,
)  # fmt: skip
_NEAR: Final = 3.0  # steps by which the last value of a counter may be short of its range
_MANY: Final = 0.05  # of the rows: rows that go back so often are those of several loggers
_GOES_ON: Final = 0.5  # of a step: how far the angle may be off where the rows go on evenly


def rows_in_order(
    times: Array,
    column: str,
    turned: Array | None = None,
    twice: Sequence[int] | NDArray[np.int64] = (),
    *,
    again: bool = False,
    unit: str = "",
) -> tuple[Problem | None, slice]:
    """Return what is wrong with the order of times (n,), and the longest ascending stretch of rows.

    `turned` (n,) is the angle of the shaft in turns, where it is known: it shows whether rows follow each other.
    `twice` are rows that repeat the row before; `again` is whether those after a step back repeat earlier ones
    (`rows_again`). `unit` stands behind differences of times in messages.
    """
    steps = np.diff(times)
    everything = slice(0, len(times))
    if len(steps) < 3 or not np.isfinite(steps).all():
        return None, everything
    if len(digits := np.flatnonzero(_next_minute(times))):
        k = int(digits[0])
        return Problem(
            f"time: '{column}' seems to have hours, minutes and seconds in one number: {times[k]:.14g} is followed by "
            f"{times[k + 1]:.14g} in row {k + 2}.",
            "Write seconds from the beginning, or dates with times such as 2026-05-04T10:00:00.0005.",
        ), slice(0, k + 1)
    if rounded_to(times) is not None and not len(twice):
        return None, everything
    period = float(np.median(steps[:SOME]))
    scatter = 1.4826 * float(np.median(np.abs(steps - np.median(steps))))
    wrong = np.flatnonzero(steps < -_CLEAR_STEPS * scatter)
    if not len(wrong) and (len(twice) or scatter < 0.1 * abs(period)):
        wrong = np.flatnonzero(steps <= 0.0)
    if not len(wrong):
        return None, everything
    edges = np.r_[0, wrong + 1, len(times)]
    longest = int(np.argmax(np.diff(edges)))
    part = slice(int(edges[longest]), int(edges[longest + 1]))
    order = "again" if again else "goes on" if _go_on(turned, wrong) else ""
    return Problem(*_order_problem(times, wrong, period, column, order, unit)), part


def rows_again(times: Array, readings: Sequence[NDArray[Any]]) -> bool:
    """Whether the rows at which times (n,) go back repeat earlier ones: the times and all readings (n,)."""
    back = np.flatnonzero(np.diff(times) < 0.0) + 1
    for k in back[:_PLACES].tolist():
        first = int(np.argmax(times[:k] == times[k]))
        count = min(_BESIDE, len(times) - k, k - first)
        if not all(
            np.array_equal(own[first : first + count], own[k : k + count], equal_nan=True)
            for own in (times, *readings)
        ):
            return False
    return bool(len(back) and len(readings))


def _next_minute(times: Array) -> NDArray[np.bool_]:
    """Return after which rows numbers such as 105959.9 go on with 110000.0: digits of a clock, and not of a number."""
    second = np.mod(times, 100.0)
    jump = np.mod(np.diff(times), 4000.0)  # 40 to the next minute, 4040 to the next hour
    ends = (second[:-1] > 59.0) & (second[1:] < 1.0) & (jump > 39.5) & (jump < 41.0)
    return np.asarray(ends & bool(np.all(second <= 60.0)))


def _go_on(turned: Array | None, wrong: NDArray[np.int64]) -> bool:
    """Whether the angle shows that it goes on evenly at some rows, so that these follow each other."""
    if turned is None:
        return False
    steps = np.diff(turned)
    steps -= np.round(steps)
    before = np.array([np.median(steps[max(k - _BESIDE, 0) : k]) if k else math.nan for k in wrong])
    if not np.isfinite(before).all() or not np.all(np.abs(before) > 1e-4):
        return False
    return bool(np.all(np.abs(steps[wrong] - before) < _GOES_ON * np.abs(before)))


def counter_range(before: Array, after: Array, period: float) -> float:
    """Return the range of a counter that restarts between two rows, equal at every such place; 0 without one."""
    near = _NEAR * abs(period)
    for own in _COUNTERS:
        if own > 10.0 * abs(period):
            plain = np.all(np.abs(before + period - own) <= near) and np.all(np.abs(after) <= near)
            half = 0.5 * own  # one with a sign
            signed = np.all(np.abs(before + period - half) <= near) and np.all(np.abs(after + half) <= near)
            if plain or signed:
                return own
    return 0.0


def _order_problem(
    times: Array, wrong: NDArray[np.int64], period: float, column: str, order: str, unit: str
) -> tuple[str, str]:
    row, places = (
        int(wrong[0]) + 2,
        f"{len(wrong)} place{'s' * (len(wrong) > 1)}, first in row {wrong[0] + 2}",
    )
    before, after = times[wrong], times[wrong + 1]
    if np.all(after == before):
        return (
            f"time: '{column}' stands still in {places}: rows are there twice.",
            "Take the second ones out, or give a `sequence`.",
        )
    if period < 0.0:
        return f"time: '{column}' runs backward.", "Turn the order of the rows round."
    whole = counter_range(before, after, period)
    if whole:
        return (
            f"time: '{column}' is a counter that restarts at {whole:.10g}, {places}.",
            f"Add {whole:.10g} to it at every new beginning: `wraps: {whole:.10g}` at `time` in the map does.",
        )
    if len(wrong) > _MANY * len(times):
        return (
            f"time: '{column}' goes back in {places}: the rows of several loggers are mixed.",
            "Sort the rows by time if they are of one logger; else write one file for each, and give each its clock.",
        )
    if np.all(np.abs(after - times[0]) <= _NEAR * abs(period)):
        return (
            f"time: '{column}' restarts in {places}: recordings follow each other.",
            f"Cut the file there, before row {row}, and import each part alone.",
        )
    back = f"{before[0] + period - after[0]:.6g}{unit}"
    if order == "again":
        return (
            f"time: '{column}' goes back by {back} in {places}: the rows from there on repeat earlier ones.",
            "Take them out; drop_duplicates() of pandas does.",
        )
    if order == "goes on":
        return (
            f"time: '{column}' was set back by {back} in {places}: the rows stand in order, since the angle goes "
            "on evenly there.",
            f"Add {back} to the times from row {row} on, or cut the file there; in another order the rows would "
            "be wrong.",
        )
    return (
        f"time: '{column}' goes back by {back} in {places}: its clock was set back, or another recording begins.",
        f"Cut the file there, before row {row}, and import each part alone; or add {back} to the times from "
        "there on, where the rows follow each other.",
    )
