"""The clock of a recording: jitter of its stamps, its rate, and the instants at which the samples were taken.

Samples are counted, so a clock that runs evenly gives them stamps on a straight line; the scatter about that line is
jitter. Either the converter samples at equal intervals and the stamp has a random error, or the instants themselves
jitter and the stamps show it. The rotor distinguishes the two: between samples that are farther apart it turns farther.
A speed, an acceleration and the phase of a harmonic come from angle over time: an error of 5 µs in a stamp is an error
of 2 mrad in the angle at 4000 rpm, more than most encoders have.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from gyrowheel_analysis.reduction.samples import Array, Samples
from gyrowheel_core.arrays import running_mean

#: Jitter over the sampling period below which the stamps are taken as they are.
_SMALL = 2.0e-4
_AVERAGED = 2001  # samples over which the clock's rate counts as constant
_FEWEST = 100  # samples without a gap
_DEPENDENT = 35.0 / 18.0  # sum of the squares of the autocorrelation of second differences of white noise
_GAP = 0.5  # s; across less the number of lost samples is certain


def evened(data: Samples, period: float) -> Samples:
    """Return samples with instants that are as regular as the turning of the rotor shows them to be.

    Every reading of the angle is a number; `period` is the sampling period [s]. The same object is returned if the
    stamps hardly jitter.
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
    # in place, since hours of samples are smoothed at once: steps, then their number from the first sample on
    number = np.zeros(len(time))
    steps = np.subtract(time[1:], time[:-1], out=number[1:])
    usual = steps[steps < 1.5 * period]
    one = float(np.median(usual, overwrite_input=True)) if len(usual) else period
    del usual
    np.rint(np.divide(steps, one, out=steps), out=steps)
    np.cumsum(number, out=number)
    # the line through all stamps, and the deviations from it
    number -= number.mean()
    middle = time.mean()
    left = time - middle
    number *= number @ left / (number @ number)
    line = np.add(number, middle, out=number)
    np.subtract(time, line, out=left)
    line += running_mean(left, min(_AVERAGED, len(time)), "edge")
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


_FEWEST_STAMPS = 1000  # samples
_TURN = 2.0 * math.pi
_ROUNDING = 1.0e-9  # s, of a stamp
#: Fourth differences of white noise have this many times its variance; of motion within a revolution little is left.
_FOURTH_SQUARE = 70.0
_BLOCK = 2048  # samples at one speed
_SPREAD = 1.15  # by which the speed must change for noise that grows with it to show


@dataclass(frozen=True)
class Stamps:
    """The clock by stamps, sample numbers and the angle of the shaft.

    Attributes
    ----------
    stated : float
        Time between samples as stated [s].
    period, period_error : float
        Mean time between samples by the stamps, and its standard error [s].
    jitter, jitter_error : float
        Standard deviation of the stamps about an even clock, and its standard error [s].
    sampled, sampled_error : float
        Part of the jitter that the samples share, and its standard error: 0 where only the stamps scatter, 1 where the
        samples are taken at their stamps. The error is infinite where the angle does not show it.
    hidden, hidden_error : float
        Jitter of the samples that shows in the angle and not in the stamps, from noise that grows with the speed, and
        its standard error [s]; infinite where all speeds are alike.
    counter, counter_error : float
        Speed by the angle and the stamps over the reading of the speed, less one, and its standard error; NaN where
        unknown.
    """

    stated: float
    period: float
    period_error: float
    jitter: float
    jitter_error: float
    sampled: float
    sampled_error: float
    hidden: float
    hidden_error: float
    counter: float
    counter_error: float


def read_stamps(data: Samples, sequence: NDArray[np.integer], period: float) -> Stamps | None:
    """Return the clock of a recording whose times are the stamps; None if it is too short or unevenly sampled.

    `sequence` (n,) has the numbers of the samples, ascending; `period` is the stated sampling period [s].
    """
    time, angle = data.time, data.readings.spin_angle
    count = _counted(time, sequence) if len(time) >= _FEWEST_STAMPS else None
    if count is None:
        return None
    x = count - count.mean()
    square = float(x @ x)
    found = float(x @ time) / square
    del x
    even = even_times(time, period)
    scale = float(np.std(time - even))
    # the effect of rounding the stamps to whole nanoseconds is no jitter
    jitter = math.sqrt(max(scale**2 - _ROUNDING**2 / 12.0, 0.0)) if scale > _ROUNDING else 0.0
    sampled, sampled_error = (0.0, math.inf)
    if jitter > 0.0 and np.isfinite(angle).all():
        sampled, sampled_error = share_of_motion(time, even, angle, period)
    del even
    hidden, hidden_error = _hidden(angle, _speed(angle, found), count)
    if sampled_error < 1.0:
        # the noise that grows with the speed is that of the stamps' own jitter too
        hidden = math.sqrt(max(hidden**2 - (sampled * jitter) ** 2, 0.0))
    counter, counter_error = _counter(time, angle, data.readings.spin_rate, count)
    slope = math.hypot(scale, _ROUNDING) / math.sqrt(square)
    return Stamps(
        stated=period,
        period=found,
        period_error=slope + _ROUNDING / float(count[-1] - count[0]),
        jitter=jitter,
        jitter_error=max(scale, _ROUNDING) / math.sqrt(2.0 * len(time)),
        sampled=sampled,
        sampled_error=sampled_error,
        hidden=hidden,
        hidden_error=hidden_error,
        counter=counter,
        counter_error=counter_error,
    )


def _counted(time: Array, sequence: NDArray[np.integer]) -> Array | None:
    """Return the numbers of the samples, put right where stamps go on by more or fewer periods; None if uneven."""
    count = (sequence - sequence[0]).astype(np.float64)
    steps, passed = np.diff(time), np.diff(count)
    single = passed == 1.0
    period = float(np.median(steps[single], overwrite_input=True)) if single.any() else 0.0
    if not period > 0.0:
        return None
    more = np.divide(steps, period, out=steps)
    more -= passed
    np.round(more, out=more)
    jumps = np.flatnonzero(more)
    if len(jumps) > 0.05 * len(time):
        return None
    if len(jumps):
        count[1:] += np.cumsum(more)
        if np.any(np.diff(count) < 1.0):
            return None
    return count


def _parts(count: int, parts: int) -> list[slice]:
    """Return slices that divide `count` elements into `parts`, as `numpy.array_split` does."""
    size, more = divmod(count, parts)
    ends = [k * size + min(k, more) for k in range(parts + 1)]
    return [slice(first, last) for first, last in pairwise(ends)]


def _speed(angle: Array, period: float) -> Array:
    """Return the speed of the shaft in blocks of `_BLOCK` samples [rad/s]."""
    steps = len(angle) - 1
    parts = [angle[part.start : part.stop + 1] for part in _parts(steps, max(steps // _BLOCK, 1))]
    return np.array([float(np.median(np.mod(np.diff(part), _TURN))) for part in parts]) / period


def _even(count: Array) -> NDArray[np.bool_]:
    """Return where five samples in a row are complete."""
    return np.asarray(count[4:] - count[:-4] == 4.0)


def _turning(angle: Array) -> Array:
    """Return the fourth differences of the angle [rad], free of whole turns."""
    steps = np.diff(angle)
    steps -= _TURN * np.round(steps / _TURN)
    return steps[3:] - 3.0 * steps[2:-1] + 3.0 * steps[1:-2] - steps[:-3]


def _typical_square(angle: Array, count: Array) -> float:
    """Return the median square of the fourth differences of the angle [rad²], NaN without samples."""
    shown, even = _turning(angle), _even(count)
    square = shown[even & np.isfinite(shown)] ** 2
    return float(np.median(square)) if len(square) else math.nan


def _hidden(angle: Array, speed: Array, count: Array) -> tuple[float, float]:
    """Return the jitter whose noise of the angle grows with the speed [s], and its standard error."""
    if not np.max(speed, initial=0.0) > _SPREAD * np.min(speed, initial=math.inf) > 0.0:
        return 0.0, math.inf
    parts = [slice(part.start, part.stop + 4) for part in _parts(len(angle) - 4, len(speed))]
    # by the median, which spikes do not move: of the square of a Gaussian number it is 0.4549 of the mean
    variance = np.array([_typical_square(angle[part], count[part]) for part in parts])
    variance /= 0.4549 * _FOURTH_SQUARE
    use = np.isfinite(variance)
    if use.sum() < 6:
        return 0.0, math.inf
    x, y = speed[use] ** 2, variance[use]
    x = x - x.mean()
    slope = float(x @ y) / float(x @ x)
    left = y - y.mean() - slope * x
    error = math.sqrt(float(left @ left) / (len(y) - 2) / float(x @ x))
    jitter = math.sqrt(max(slope, 0.0))
    return jitter, error / (2.0 * jitter) if jitter > 0.0 else math.sqrt(error)


def _counter(time: Array, angle: Array, rate: Array, count: Array) -> tuple[float, float]:
    """Return the excess of the rate of the angle by the stamps over the reading of the speed, and its error."""
    if not (np.isfinite(angle).all() and np.isfinite(rate).all()):
        return math.nan, math.inf
    even = np.diff(count) == 1.0
    steps = np.diff(angle)
    turned = float(np.mod(steps, _TURN, out=steps)[even].sum())
    del steps
    passed = np.diff(time)[even]
    between = rate[1:] + rate[:-1]
    between *= 0.5
    counted = float(between[even] @ passed)
    if not (turned > 0.0 and counted > 0.0):
        return math.nan, math.inf
    changes = np.subtract(rate[1:], rate[:-1], out=between)
    noise = float(np.median(np.abs(changes, out=changes), overwrite_input=True)) / 0.6745 / math.sqrt(2.0)
    return turned / counted - 1.0, noise * float(np.sqrt(np.sum(passed**2))) / counted
