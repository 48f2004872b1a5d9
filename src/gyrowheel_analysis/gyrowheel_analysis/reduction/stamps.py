"""The clock of a recording: how its stamps scatter, how fast it runs, and when the samples were taken.

Samples are counted, so a clock that runs evenly gives them stamps on a straight line. What scatters about that line is
jitter. A converter that waits for its clock really samples late; a stamp that is given late says nothing of the sample.
The two are told apart by the shaft: its angle goes on by speed times delay in the one case, not at all in the other.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from gyrowheel_analysis.reduction.instants import even_times, share_of_motion
from gyrowheel_analysis.reduction.samples import Samples

Array = NDArray[np.float64]

_FEWEST = 1000  # samples
_TURN = 2.0 * math.pi
_ROUNDING = 1.0e-9  # s, of a stamp
#: Fourth differences of white noise have this many times its variance; of motion within a revolution little is left.
_FOURTH_SQUARE = 70.0
_BLOCK = 2048  # samples at one speed
_SPREAD = 1.15  # by which the speed must change for noise that grows with it to show


@dataclass(frozen=True)
class Stamps:
    """What stamps, sample numbers and the angle of the shaft say of the clock.

    Attributes
    ----------
    stated : float
        Time between samples as stated [s].
    period : float
        Mean time between samples by the stamps [s].
    period_error : float
        Its standard error [s].
    jitter : float
        Standard deviation of the stamps about an even clock [s].
    jitter_error : float
        Its standard error [s].
    sampled : float
        Part of the jitter that the samples have too: 0 where only the stamps scatter, 1 where the samples are taken
        when the stamps say.
    sampled_error : float
        Its standard error; infinite where the angle does not show it.
    hidden : float
        Jitter of the samples that shows in the angle and not in the stamps [s], from noise that grows with the speed.
    hidden_error : float
        Its standard error [s]; infinite where all speeds are alike.
    counter : float
        Speed by the angle and the stamps over the reading of the speed, less one; NaN where it is not known.
    counter_error : float
        Its standard error.
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
    """Look at the clock of a recording.

    Parameters
    ----------
    data : Samples
        The recording; its times are the stamps.
    sequence : ndarray (n,)
        Numbers of the samples, ascending.
    period : float
        Sampling period as stated [s].

    Returns
    -------
    Stamps or None
        None for a recording that is too short or whose samples are not evenly spaced.
    """
    time, angle = data.time, data.readings.spin_angle
    count = _counted(time, sequence) if len(time) >= _FEWEST else None
    if count is None:
        return None
    x = count - count.mean()
    square = float(x @ x)
    found = float(x @ time) / square
    del x
    even = even_times(time, period)
    scale = float(np.std(time - even))
    # what rounding of the stamps to whole nanoseconds gives, is none
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


def _wrapped(values: Array) -> Array:
    return values - _TURN * np.round(values / _TURN)


def _parts(count: int, parts: int) -> list[slice]:
    """Return so many parts of an array of `count` elements, as `numpy.array_split` makes them."""
    size, more = divmod(count, parts)
    ends = [k * size + min(k, more) for k in range(parts + 1)]
    return [slice(first, last) for first, last in pairwise(ends)]


def _speed(angle: Array, period: float) -> Array:
    """Return the speed of the shaft in blocks of `_BLOCK` samples [rad/s]."""
    steps = len(angle) - 1
    parts = [angle[part.start : part.stop + 1] for part in _parts(steps, max(steps // _BLOCK, 1))]
    return np.array([float(np.median(np.mod(np.diff(part), _TURN))) for part in parts]) / period


def _even(count: Array) -> NDArray[np.bool_]:
    """Whether five samples in a row lack none between them."""
    return np.asarray(count[4:] - count[:-4] == 4.0)


def _turning(angle: Array) -> Array:
    """Return the fourth differences of the angle [rad], turn by turn the same."""
    steps = _wrapped(np.diff(angle))
    return steps[3:] - 3.0 * steps[2:-1] + 3.0 * steps[1:-2] - steps[:-3]


def _typical_square(angle: Array, count: Array) -> float:
    """Return the median square of the fourth differences of the angle [rad²], NaN where there is none."""
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
    """Return by how much the angle turns faster by the stamps than the reading of the speed says, and the error."""
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
