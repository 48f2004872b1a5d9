"""The steps of the converters: whether a reading changes by whole multiples of one step, and of which."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gyrowheel_core.readings import READINGS, Readings

Array = NDArray[np.float64]

_PIECES, _LENGTH = 4, 2000  # samples that are looked at, in pieces of the recording
_ROUNDING = 32.0  # of the last digit of the largest value: smaller changes are none
_NEAR = 0.02  # of a step: how far from a whole number of steps a change may be
_MOST_OFF = 0.01  # of the changes
_TRIES = 3  # gaps between those that are tried as a step
_FEWEST = 10  # changes; a reading that stays has any step
_SINGLE = 2.0**-22  # of the largest value: the digits of numbers in single precision, as files may hold them


def steps(readings: Readings) -> dict[str, float]:
    """Return the step of every reading that changes by whole steps, by name [SI].

    The zero of the steps is free. A step far below the noise is found too, unless so few values are near each other
    that no two of them are neighbours.
    """
    found = {}
    for name in READINGS:
        values = readings[name]
        starts = np.linspace(0, max(len(values) - _LENGTH, 0), _PIECES).astype(np.int64)
        changes = np.concatenate([np.diff(values[start : start + _LENGTH]) for start in starts])
        changes = changes[np.isfinite(changes)]
        if name == "spin_angle":
            changes = changes[changes >= 0.0]  # a turn need not be a whole number of steps
        if np.count_nonzero(changes) < _FEWEST:
            continue
        digit = float(np.finfo(np.float64).eps) * float(np.nanmax(np.abs(values), initial=0.0))
        step = _step(np.unique(np.abs(changes)), _ROUNDING * digit)
        if step > _SINGLE * digit / np.finfo(np.float64).eps:
            found[name] = step
    return found


def _step(values: Array, digit: float) -> float:
    """Return the step of which nearly all of sorted values are whole multiples; 0 if they are of none.

    `digit` is the size of their rounding.
    """
    gaps = np.diff(values, prepend=0.0)
    gaps = np.sort(gaps[gaps > digit])
    # where values are many, the smallest gap is one step, unless a value is off
    for step in gaps[: 4 * _TRIES : _TRIES]:
        if _NEAR * step < 4.0 * digit:
            continue
        # a step that is slightly off misses large values: it is refined on ever larger ones
        for reach in np.geomspace(10.0 * step, max(float(values[-1]), 10.0 * step), 8):
            some = values[values <= reach]
            whole = np.round(some / step)
            some, whole = (x[np.abs(some - whole * step) <= 0.1 * step] for x in (some, whole))
            if np.any(whole):
                step = float(whole @ some) / float(whole @ whole)
        off = np.abs(values - np.round(values / step) * step) > _NEAR * step + digit
        if off.mean() <= _MOST_OFF:
            return float(step)
    return 0.0
