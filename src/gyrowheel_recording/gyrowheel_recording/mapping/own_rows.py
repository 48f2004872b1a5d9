"""Tables in which several instruments share the columns of time, and each has values only in separate rows."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_SPARSE = 0.5  # part of the rows of samples; a slow reading with more values has holes, and no separate rows
#: Smallest part of the rows that are no samples, where slow readings stand in rows of samples, too.
_FEWEST = 0.02
_BRIDGED = 4.5  # usual distances of rows with values; a wider gap is a hole


def sample_rows(fast: Mapping[str, Array], slow: Mapping[str, Array]) -> NDArray[np.bool_]:
    """Return which rows of a table are samples: some have values of slow readings alone.

    `fast` and `slow` have the values (n,) of all readings, NaN where a value is missing.
    """
    every = next(iter([*fast.values(), *slow.values()]))
    if not fast or not slow:
        return np.ones(len(every), dtype=bool)
    samples = np.logical_or.reduce([np.isfinite(values) for values in fast.values()])
    others = np.logical_or.reduce([np.isfinite(values) for values in slow.values()]) & ~samples
    apart = not any(np.isfinite(values[samples]).any() for values in slow.values())
    fewest = 2.0 if apart else max(_FEWEST * len(every), 1.0)
    if np.count_nonzero(samples) < 2 or np.count_nonzero(others) < fewest:
        return np.ones(len(every), dtype=bool)
    return np.asarray(samples | ~others)


def interpolated(time: Array, values: Array, samples: NDArray[np.bool_]) -> Array | None:
    """Return a slow reading with separate rows, interpolated to the rows of samples; None for any other reading.

    It stays NaN within gaps of its rows.
    """
    known = np.isfinite(values)
    if float(np.mean(known[samples])) > _SPARSE or np.count_nonzero(known) < 2:
        return None
    there = time[known]
    usual = float(np.median(np.diff(there)))
    when = time[samples]
    after = np.clip(np.searchsorted(there, when), 1, len(there) - 1)
    hole = there[after] - there[after - 1] > _BRIDGED * usual
    outside = (when < there[0] - _BRIDGED * usual) | (when > there[-1] + _BRIDGED * usual)
    inside = (when > there[after - 1]) & (when < there[after])
    return np.where(outside | (hole & inside), np.nan, np.interp(when, there, values[known]))
