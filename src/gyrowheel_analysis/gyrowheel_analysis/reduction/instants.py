"""Sampling instants: stamps without the part of their jitter that is no motion of the instants themselves.

A converter samples at equal intervals, and the stamp is put on by something else, with a random error of its own; or
the instants themselves jitter, and the stamps show it. The rotor tells the two apart: between samples that are
farther apart it turns farther. A speed, an acceleration and the phase of a harmonic come from angle over time, so that
an error of 5 µs in a stamp is an error of 2 mrad in the angle at 4000 rpm, more than most encoders have.
"""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np

from gyrowheel_analysis.reduction.samples import Array, Samples

#: Jitter over the sampling period below which the stamps are taken as they are.
_SMALL = 2.0e-4
_AVERAGED = 2001  # samples over which the clock's rate counts as constant
_FEWEST = 100  # samples without a gap
_DEPENDENT = 35.0 / 18.0  # sum of the squares of the autocorrelation of second differences of white noise
_GAP = 0.5  # s; across less the number of lost samples is certain


def evened(data: Samples, period: float) -> Samples:
    """Return samples with instants that are as regular as the turning of the rotor shows them to be.

    Parameters
    ----------
    data : Samples
        The samples; every reading of the angle is a number.
    period : float
        Sampling period [s].

    Returns
    -------
    Samples
        The same object if the stamps hardly jitter.
    """
    time = data.time
    if len(time) < _FEWEST:
        return data
    jumps = np.diff(time)
    # the second difference of jitter has six times its variance; the median ignores gaps
    if np.median(np.abs(np.diff(jumps))) < 0.6745 * np.sqrt(6.0) * _SMALL * period:
        return data
    even = even_times(time, period)
    share, _ = share_of_motion(time, even, data.readings.spin_angle, period)
    return replace(data, time=even + share * (time - even))


def even_times(time: Array, period: float) -> Array:
    """Return stamps [s] without their jitter, run by run between gaps; `period` is the sampling period [s]."""
    breaks = _breaks(time)
    even = np.empty(len(time))
    for first, last in pairwise([0, *breaks, len(time)]):
        run = time[first:last]
        even[first:last] = _smooth(run, period) if len(run) >= _FEWEST else run
    return even


def _breaks(time: Array) -> list[int]:
    """Return the samples before which the number of lost ones is not certain."""
    jumps = np.diff(time)
    found: list[int] = (np.flatnonzero((jumps > _GAP) | (jumps <= 0.0)) + 1).tolist()
    return found


def _smooth(time: Array, period: float) -> Array:
    """Return the instants of samples without their jitter: even, at a rate that changes slowly."""
    # the library takes long to load, and the node of the drag estimator has no use for it
    from scipy.ndimage import uniform_filter1d

    # in place, since hours of samples are smoothed at once: steps, then their number from the first sample on
    number = np.zeros(len(time))
    steps = np.subtract(time[1:], time[:-1], out=number[1:])
    usual = steps[steps < 1.5 * period]
    one = float(np.median(usual, overwrite_input=True)) if len(usual) else period
    del usual
    np.rint(np.divide(steps, one, out=steps), out=steps)
    np.cumsum(number, out=number)
    # the line through all stamps, and what is left of them
    number -= number.mean()
    middle = time.mean()
    left = time - middle
    number *= number @ left / (number @ number)
    line = np.add(number, middle, out=number)
    np.subtract(time, line, out=left)
    line += uniform_filter1d(left, min(_AVERAGED, len(time)), output=left, mode="nearest")
    return line


def share_of_motion(time: Array, even: Array, angle: Array, period: float) -> tuple[float, float]:
    """Return the share of the jitter that the angle shows too, and its standard error.

    It is 1 if the instants jitter, 0 if the stamps alone do. Arguments are stamps, the same without jitter [s], the
    readings of the angle [rad], and the sampling period [s].
    """
    regular = np.abs(np.diff(even) - period) < 0.5 * period
    whole = regular[1:] & regular[:-1]
    turned = np.diff(np.unwrap(angle))
    speed = 0.5 * (turned[1:] + turned[:-1])[whole] / period
    shown = np.diff(turned)[whole]
    stamped = speed * np.diff(time - even, 2)[whole]
    square = float(stamped @ stamped)
    if not square > 0.0:
        return 1.0, math.inf
    share = float(stamped @ shown) / square
    left = shown - share * stamped
    # second differences of white noise depend on each other, which makes their slope less certain
    error = math.sqrt(_DEPENDENT * float(left @ left) / len(left) / square)
    return min(max(share, 0.0), 1.0), error
