"""The order of the rows of a table: times that go back, begin anew or come twice, and which rows can be looked at."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from gyrowheel_recording.mapping.suggestion.records import Problem
from gyrowheel_recording.mapping.suggestion.sizes import SOME

Array = NDArray[np.float64]

_CLEAR: Final = 6.0  # robust standard deviations of the steps, as for the clock of an import
_COUNTERS: Final = (*(2.0**k for k in (8, 12, 16, 24, 32)), 1e3, 6e4, 1e5, 1e6, 60.0, 3600.0, 86400.0)
_NEAR: Final = 3.0  # steps by which the last value of a counter may be short of its range
_MANY: Final = 0.05  # of the rows: rows that go back so often are those of several loggers


def rows_in_order(times: Array, column: str) -> tuple[Problem | None, slice]:
    """Return what is wrong with the order of times, and the longest stretch of rows that ascends.

    Parameters
    ----------
    times : ndarray (n,)
        Times in the unit of the table.
    column : str
        Name of their column.
    """
    steps = np.diff(times)
    everything = slice(0, len(times))
    if len(steps) < 3 or not np.isfinite(steps).all():
        return None, everything
    period = float(np.median(steps[:SOME]))
    scatter = 1.4826 * float(np.median(np.abs(steps - np.median(steps))))
    wrong = np.flatnonzero(steps < -_CLEAR * scatter)
    if not len(wrong) and scatter < 0.1 * abs(period):
        wrong = np.flatnonzero(steps <= 0.0)
    if not len(wrong):
        return None, everything
    edges = np.r_[0, wrong + 1, len(times)]
    longest = int(np.argmax(np.diff(edges)))
    part = slice(int(edges[longest]), int(edges[longest + 1]))
    return Problem(*_words(times, steps, wrong, period, column)), part


def _words(
    times: Array, steps: Array, wrong: NDArray[np.int64], period: float, column: str
) -> tuple[str, str]:
    row, places = (
        int(wrong[0]) + 2,
        f"{len(wrong)} place{'s' * (len(wrong) > 1)}, first in row {wrong[0] + 2}",
    )
    if np.all(steps[wrong] == 0.0):
        return (
            f"time: '{column}' stands still in {places}: rows are there twice.",
            "Take the second ones out, or give a `sequence`.",
        )
    if period < 0.0:
        return f"time: '{column}' runs backward.", "Turn the order of the rows round."
    if len(wrong) > _MANY * len(times):
        return (
            f"time: '{column}' goes back in {places}: the rows of several loggers are mixed.",
            "Sort the rows by time if they are of one logger; else write one file for each, and give each its clock.",
        )
    before, after = times[wrong], times[wrong + 1]
    whole = next(
        (
            c
            for c in _COUNTERS
            if np.all(np.abs(before + period - c) <= _NEAR * abs(period))
            and np.all(np.abs(after) <= _NEAR * abs(period))
        ),
        0.0,
    )
    if whole:
        return (
            f"time: '{column}' is a counter that begins anew at {whole:.10g}, {places}.",
            f"Add {whole:.10g} to it at every new beginning.",
        )
    if np.all(np.abs(after - times[0]) <= _NEAR * abs(period)):
        return (
            f"time: '{column}' begins anew in {places}: recordings stand one behind the other.",
            f"Cut the file there, before row {row}, and import each part by itself.",
        )
    return (
        f"time: '{column}' goes back by {-float(steps[wrong[0]]):.6g} in {places}.",
        "Sort the rows by time, or cut the file there.",
    )
