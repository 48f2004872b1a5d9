"""The clock of a table: sampling rate, jitter, missing samples; and the offset between the clocks of two loggers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from gyrowheel_core.errors import InputError
from gyrowheel_core.units import conversion
from gyrowheel_recording.bags.reader import LONGEST, SHORTEST
from gyrowheel_recording.tables import Grid
from gyrowheel_sim.bench import Bench

Array = NDArray[np.float64]

#: How far from the first row a time can be [s]: some three years.
FARTHEST: Final = 1e8
_AROUND: Final = 20  # rows before and after a gap by which its length is measured
_STRIDE: Final = 50  # rows over which the period is taken, so that neither jitter nor rounding shows
_CLEAR: Final = 6.0  # robust standard deviations of the steps
_EXACT: Final = 1e-9  # s, of a stamp
_EVEN: Final = 0.3  # of the period: with more jitter the count of the samples is better than the stamps
_JITTERS: Final = 2e-6  # s; less is not reported
#: Rounded times: part of the steps that are zero, and part that have the usual size; rows by which groups of equal
#: times differ; part by which steps differ from whole ones; fewest rows.
_REPEATED, _MOSTLY, _UNEVEN, _OFF, _FEWEST = 0.2, 0.95, 1.0, 0.02, 20
#: The same where times are rounded to little more than the period: part of the steps that are zero, their fewest
#: number, and part of them at the usual distance from the next one.
_SELDOM, _FEW, _EVENLY = 0.005, 5, 0.8


@dataclass(frozen=True)
class Clock:
    """When the samples of a table were taken."""

    period: float  # sampling period [s]
    sequence: NDArray[np.int64]  # (n,): numbers of the samples from 0 on; missing ones are counted
    stamps_ns: NDArray[np.int64]  # (n,): stamps from 0 on [ns], strictly ascending
    remarks: tuple[str, ...]  # findings


class ClockError(InputError):
    """Times that are impossible for a clock."""

    def __init__(self, row: int, what: str) -> None:
        self.row = row  # the row with the fault; -1 for all of them
        super().__init__(what)


def clock_of(time: Array, numbers: NDArray[np.int64] | None = None) -> Clock:
    """Return the clock of a table.

    `time` (n,): times of the rows [s], up to `FARTHEST` from the first; they may jitter, and be rounded.
    `numbers` (n,): numbers of the samples, strictly ascending; if not given, gaps show in the times. Raises
    ClockError if the times go back, repeat without being rounded, or have an impossible rate.
    """
    steps = np.diff(time)
    period = period_of(time) if numbers is None else _slope(time, numbers)
    scatter = 1.4826 * float(np.median(np.abs(steps - np.median(steps))))
    rounding = rounded_to(time)
    wrong = np.flatnonzero(steps < -max(_CLEAR * scatter, 0.0))
    if not len(wrong) and scatter < 0.1 * period and rounding is None:
        wrong = np.flatnonzero(steps <= 0.0)
    if len(wrong):
        k = int(wrong[0])
        what = "the same time as" if steps[k] == 0.0 else f"{-1e3 * steps[k]:.6g} ms before"
        raise ClockError(
            k + 1,
            f"{what} the row before; time must ascend (was the clock set back, or does another "
            "recording begin? add what is missing, or cut the table there)",
        )
    if not SHORTEST <= period <= LONGEST:
        raise ClockError(
            -1,
            f"a row every {1e3 * period:.6g} ms; allowed: {1e3 * SHORTEST:g} .. {1e3 * LONGEST:g} ms "
            "(is the unit right?)",
        )
    if numbers is not None:
        sequence = numbers - numbers[0]
    elif rounding is not None:
        sequence = _counted_groups(time, period)
    else:
        sequence = _counted(time, period, scatter)
    period, even = _fitted(time, sequence)
    off = time - even
    jitter = float(np.std(off))
    whole = np.abs(steps - period * np.round(steps / period)) < 2.0 * _OFF * period
    if rounding is None and jitter > period and numbers is None and float(np.mean(whole)) < _MOSTLY:
        raise ClockError(
            -1,
            f"times jitter by {1e3 * jitter:.4g} ms, {jitter / period:.3g} rows; allowed: up to one row (are the rows "
            "of one logger, in the order in which they were taken? `sequence:` in the map may number them)",
        )
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
        how = (
            f"jitter by {1e3 * jitter:.2g} ms"
            if rounding is None
            else f"are rounded by {1e3 * rounding:.4g} ms"
        )
        remarks.append(f"times {how}; samples are put {1e3 * period:.6g} ms apart")
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
    plain = float(np.median(time[stride:] - time[:-stride])) / stride
    rounding = rounded_to(time)
    if rounding is None:
        return plain
    sizes = _groups(time)[1:-1]
    return (
        rounding / float(np.mean(sizes[np.abs(sizes - np.median(sizes)) <= _UNEVEN])) if len(sizes) else plain
    )


def rows_twice(time: Array, columns: Sequence[Array]) -> NDArray[np.int64]:
    """Return the rows (from 0 on) with the time of the row before, where most of these repeat its readings, too.

    Rows with rounded times repeat none.
    """
    still = np.flatnonzero(np.diff(time) == 0.0)
    own = [values for values in columns if len(values) == len(time)]
    if not len(still) or not own:
        return np.zeros(0, dtype=np.int64)
    equal = np.logical_and.reduce([values[still + 1] == values[still] for values in own])
    return still + 1 if float(np.mean(equal)) > _MOSTLY else np.zeros(0, dtype=np.int64)


def rounded_to(time: Array) -> float | None:
    """Return to what the times of rows are rounded so that several rows have the same, or None where they are not.

    As many rows have each time, but for one more or less; repeated rows do not count.
    """
    steps = np.diff(time)
    repeated = float(np.mean(steps == 0.0)) if len(steps) else 0.0
    if len(steps) < _FEWEST or np.any(steps < 0.0) or not _SELDOM < repeated < 1.0:
        return None
    if (
        repeated < _REPEATED
    ):  # to little more than the period: every so many rows, evenly, two have the same time
        apart = np.diff(np.flatnonzero(steps == 0.0))
        usual = float(np.median(apart)) if len(apart) >= _FEW else 0.0
        even = np.abs(apart - usual) <= max(1.5 * _UNEVEN, 0.1 * usual)
        return float(np.median(steps)) if usual and float(np.mean(even)) > _EVENLY else None
    sizes = _groups(time)[1:-1]
    ahead = steps[steps > 0.0]
    rounding = float(np.median(ahead))
    whole = np.abs(ahead / rounding - np.round(ahead / rounding)) < _OFF
    if len(sizes) < 2 or float(np.mean(np.abs(sizes - np.median(sizes)) <= _UNEVEN)) < _MOSTLY:
        return None
    return rounding if float(np.mean(whole)) > _MOSTLY else None


def _groups(time: Array) -> NDArray[np.int64]:
    """Return how many rows in a row have the same time."""
    return np.diff(np.r_[0, np.flatnonzero(np.diff(time) != 0.0) + 1, len(time)])


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
        # with jitter or rounding, a gap is a lasting offset between the rows before and after
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


def _counted_groups(time: Array, period: float) -> NDArray[np.int64]:
    """Return the numbers of the samples by times that several of them share: a group with too few has lost some."""
    first = np.r_[0, np.flatnonzero(np.diff(time) != 0.0) + 1]
    sizes, steps = np.diff(first), np.diff(time[first]) / period
    lacking = steps - sizes
    if len(lacking):
        lacking[0] = 0.0  # the table begins within a group
    more = np.zeros(len(time), dtype=np.int64)
    at = np.flatnonzero(lacking > 1.0 + _UNEVEN)
    for some in np.split(at, np.flatnonzero(np.diff(at) > 2) + 1) if len(at) else []:
        lost = round(float(lacking[max(int(some[0]) - 1, 1) : int(some[-1]) + 2].sum()))
        widest = int(some[np.argmax(lacking[some])])
        more[first[widest + 1]] = max(lost, 0)
    return np.asarray(np.arange(len(time)) + np.cumsum(more), dtype=np.int64)


def _fitted(time: Array, sequence: NDArray[np.int64]) -> tuple[float, Array]:
    """Return the mean period, and the times of an even clock."""
    x = sequence - float(np.mean(sequence))
    middle = float(np.mean(time))
    square = float(x @ x)
    period = float(x @ (time - middle)) / square if square else 0.0
    return period, np.asarray(middle + period * x, dtype=np.float64)


#: A motion and what drives it: the rate of the one follows the other, by the laws of the wheel.
_DRIVEN: Final = (
    ("spin_rate", "motor_current"),
    ("tilt_x", "coil_voltage_y"),
    ("tilt_y", "coil_voltage_x"),
    ("tilt_x", "coil_current_y"),
    ("tilt_y", "coil_current_x"),
)
_STEP: Final = 2e-3  # s
_FARTHEST: Final = 60.0  # s
_LEAST: Final = 0.5  # correlation
_SAME: Final = 0.5  # part of the times that two clocks share, from which on they are one


def clock_offset(
    found: Mapping[str, Any], grid: Grid, clock: str, bench: Bench
) -> tuple[float, float] | None:
    """Return what must be added to the times of a clock to be those of the map's, and its standard error [s].

    `found` are the `Proposal` of the columns, `clock` is the column with the times of the other clock. None where no
    pair of readings on the two clocks resembles each other.
    """
    main = grid.columns[found["time"].column]
    one_file = all(main.name.startswith(f"{own}/") == clock.startswith(f"{own}/") for own in grid.files)
    if one_file and main.clock and _shared(grid.columns[clock].values, main.values) > _SAME:
        return 0.0, _EXACT
    best: tuple[float, float, float] | None = None
    for pair in _DRIVEN:
        if not all(name in found for name in pair):
            continue
        sides = {bool(found[name].clock == clock): name for name in pair}
        if len(sides) != 2 or found[sides[False]].clock:
            continue
        there, here = (_series(found, grid, sides[side]) for side in (True, False))
        if there is None or here is None:
            continue
        match = _match(here, there, moves=sides[False] == pair[0])
        if match is not None and (best is None or match[2] > best[2]):
            best = match
    return None if best is None or best[2] < _LEAST else (best[0], best[1])


def _shared(one: NDArray[Any], other: NDArray[Any]) -> float:
    """Return the part of the times of one clock that another one has to the last digit: stamps of the same samples."""
    return 0.0 if one.dtype.kind != other.dtype.kind or not len(one) else float(np.mean(np.isin(one, other)))


def _series(found: Mapping[str, Any], grid: Grid, name: str) -> tuple[Array, Array] | None:
    own, main = found[name], found["time"]
    raw, first = (grid.columns[column].values for column in (own.clock or main.column, main.column))
    if raw.dtype.kind == "M" and first.dtype.kind == "M":
        times = (raw - first[0]).astype("timedelta64[ns]").astype(np.float64) * 1e-9
    else:
        try:
            factor = conversion(main.unit, "s")[1]
        except InputError:
            return None
        times = np.asarray(raw, dtype=np.float64) * factor
    values = np.asarray(grid.columns[own.column].values, dtype=np.float64)
    known = np.isfinite(values) & np.isfinite(times)
    return (times[known], values[known]) if known.sum() > 100 else None


def _match(
    here: tuple[Array, Array], there: tuple[Array, Array], *, moves: bool
) -> tuple[float, float, float] | None:
    """Return the offset at which two series resemble each other most, its error, and their correlation there.

    `moves` is whether the first one is the motion, whose rate counts.
    """
    begin, end = min(here[0][0], there[0][0]), max(here[0][-1], there[0][-1])
    if not 500 <= (end - begin) / _STEP <= 4_000_000:  # two epochs may be decades apart
        return None
    grid = np.arange(begin, end, _STEP)
    one, other = _smoothed(grid, *here, rate=moves), _smoothed(grid, *there, rate=not moves)
    size = 1 << (2 * len(grid) - 1).bit_length()
    product = np.fft.irfft(np.fft.rfft(one, size) * np.conj(np.fft.rfft(other, size)), size)
    most = min(round(_FARTHEST / _STEP), len(grid) - 1)
    lags = np.arange(-most, most + 1)
    sizes = np.abs(product[lags])
    k = int(np.argmax(sizes))
    norm = float(np.linalg.norm(one) * np.linalg.norm(other))
    if not norm or not 0 < k < len(lags) - 1:
        return None
    left, middle, right = sizes[k - 1 : k + 2]
    bend = left - 2.0 * middle + right
    shift = 0.5 * (left - right) / bend if bend < 0.0 else 0.0
    correlation = float(middle) / norm
    # the curvature of the peak against what is not alike
    noise = np.sqrt(max(1.0 - correlation**2, 1e-12)) * norm / np.sqrt(len(grid))
    error = _STEP * float(noise / max(-bend, 1e-300)) if bend < 0.0 else _STEP
    return float(lags[k] + shift) * _STEP, min(max(error, 0.1 * _STEP), 0.1), correlation


def _smoothed(grid: Array, times: Array, values: Array, *, rate: bool) -> Array:
    """Return values, or their rate, averaged over a tenth of a second, on a grid; zero outside of their times."""
    width = round(0.1 / _STEP)
    smooth = np.convolve(np.interp(grid, times, values), np.ones(width) / width, mode="same")
    result = np.gradient(smooth) if rate else smooth
    inside = (grid > times[0] + 0.1) & (grid < times[-1] - 0.1)
    result = result - np.mean(result[inside]) if inside.any() else result
    return np.where(inside, result, 0.0)
