"""The clock of a table: its sampling rate, what jitters or is rounded in its times, and which samples are missing."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from gyrowheel_core.errors import InputError
from gyrowheel_recording.bags.sampling import LONGEST, SHORTEST

Array = NDArray[np.float64]

#: How far from the first row a time can be [s]: some three years.
FARTHEST: Final = 1e8
_AROUND: Final = 20  # rows before and after a gap by which its length is told
_STRIDE: Final = 50  # rows over which the period is taken, so that neither jitter nor rounding shows
_CLEAR: Final = 6.0  # robust standard deviations of the steps
_EXACT: Final = 1e-9  # s, of a stamp
_EVEN: Final = 0.3  # of the period: beyond that jitter the stamps say less than the count of the samples
_JITTERS: Final = 2e-6  # s; less is not worth saying


@dataclass(frozen=True)
class Clock:
    """When the samples of a table were taken.

    Attributes
    ----------
    period : float
        Sampling period [s].
    sequence : ndarray (n,)
        Numbers of the samples from 0 on; missing ones are counted.
    stamps_ns : ndarray (n,)
        Stamps from 0 on [ns], strictly ascending.
    remarks : tuple of str
        What there is to say about it.
    """

    period: float
    sequence: NDArray[np.int64]
    stamps_ns: NDArray[np.int64]
    remarks: tuple[str, ...]


class ClockError(InputError):
    """Times that no clock gives.

    Attributes
    ----------
    row : int
        The row with the fault; -1 for all of them.
    """

    def __init__(self, row: int, what: str) -> None:
        self.row = row
        super().__init__(what)


def clock_of(time: Array, numbers: NDArray[np.int64] | None = None) -> Clock:
    """Return the clock of a table.

    Parameters
    ----------
    time : ndarray (n,)
        Times of the rows [s], up to `FARTHEST` from the first; they may jitter, and be rounded.
    numbers : ndarray (n,), optional
        Numbers of the samples, strictly ascending; where there are none, gaps show in the times.

    Raises
    ------
    ClockError
        If the times go back, repeat without being rounded, or are of no rate that can be meant.
    """
    steps = np.diff(time)
    period = period_of(time) if numbers is None else _slope(time, numbers)
    scatter = 1.4826 * float(np.median(np.abs(steps - np.median(steps))))
    wrong = np.flatnonzero(steps < -max(_CLEAR * scatter, 0.0))
    if not len(wrong) and scatter < 0.1 * period:
        wrong = np.flatnonzero(steps <= 0.0)
    if len(wrong):
        k = int(wrong[0])
        what = "the same time as" if steps[k] == 0.0 else f"{-1e3 * steps[k]:.6g} ms before"
        raise ClockError(
            k + 1, f"{what} the row before; time must ascend (sort the rows, or cut them in two files)"
        )
    if not SHORTEST <= period <= LONGEST:
        raise ClockError(
            -1,
            f"a row every {1e3 * period:.6g} ms; allowed: {1e3 * SHORTEST:g} .. {1e3 * LONGEST:g} ms "
            "(is the unit right?)",
        )
    sequence = _counted(time, period, scatter) if numbers is None else numbers - numbers[0]
    period, even = _fitted(time, sequence)
    off = time - even
    jitter = float(np.std(off))
    given = np.round((time - time[0]) / _EXACT).astype(np.int64)
    remarks = []
    rate = 1.0 / period
    missing = int(sequence[-1]) + 1 - len(sequence)
    if missing:
        gaps = int(np.count_nonzero(np.diff(sequence) > 1))
        remarks.append(
            f"{missing} samples missing in {gaps} gap{'s' * (gaps > 1)}, {missing * period:.3g} s: they count as lost"
        )
    if jitter > _EVEN * period or np.any(np.diff(given) <= 0):
        stamps = np.round((even - even[0]) / _EXACT).astype(np.int64)
        remarks.append(
            f"times are rounded or jitter by {1e3 * jitter:.2g} ms; samples are put {1e3 * period:.6g} ms apart"
        )
    else:
        stamps = given
        if jitter > _JITTERS:
            remarks.append(
                f"times jitter by {1e3 * jitter:.2g} ms; the analysis asks the angle whether the samples do"
            )
    remarks.insert(0, f"{rate:.6g} samples a second")
    return Clock(period, sequence, stamps, tuple(remarks))


def period_of(time: Array) -> float:
    """Return the period by steps over many rows, whose median neither gaps nor jitter move."""
    stride = min(_STRIDE, max((len(time) - 1) // 4, 1))
    return float(np.median(time[stride:] - time[:-stride])) / stride


def _slope(time: Array, numbers: NDArray[np.int64]) -> float:
    span = float(numbers[-1] - numbers[0])
    return float(time[-1] - time[0]) / span if span else 0.0


def _counted(time: Array, period: float, scatter: float) -> NDArray[np.int64]:
    """Return the numbers of the samples by their times."""
    from scipy.ndimage import median_filter

    steps = np.diff(time)
    more = np.zeros(len(steps), dtype=np.int64)
    at = np.flatnonzero(steps > 1.5 * period)
    if scatter < 0.1 * period:
        more[at] = np.maximum(np.round(steps[at] / period).astype(np.int64) - 1, 0)
    elif len(at):
        # beside jitter or rounding, a gap is what lasts: rows before and after lie on lines that are apart
        late = time - period * np.arange(len(time))
        smooth = median_filter(late, 2 * _AROUND + 1, mode="nearest")
        before = smooth[np.maximum(at - _AROUND, 0)]
        after = smooth[np.minimum(at + 1 + _AROUND, len(time) - 1)]
        lost = np.round((after - before) / period).astype(np.int64)
        # of neighbours that see the same gap, the widest step is it
        order = np.argsort(-steps[at], kind="stable")
        taken = np.zeros(len(time) + 1, dtype=bool)
        for k in order:
            if lost[k] < 1 or steps[at[k]] < 0.5 * lost[k] * period:
                continue
            low, high = max(at[k] - _AROUND, 0), at[k] + _AROUND + 1
            if taken[low:high].any():
                continue
            taken[at[k]] = True
            more[at[k]] = lost[k]
    return np.concatenate([[0], np.cumsum(1 + more)]).astype(np.int64)


def _fitted(time: Array, sequence: NDArray[np.int64]) -> tuple[float, Array]:
    """Return the mean period, and the times of an even clock."""
    x = sequence - float(np.mean(sequence))
    middle = float(np.mean(time))
    square = float(x @ x)
    period = float(x @ (time - middle)) / square if square else 0.0
    return period, np.asarray(middle + period * x, dtype=np.float64)
