"""A recording in short blocks, and averages over a fraction of a second, on which the physics of setups is tested."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Set
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from gyrowheel_core.arrays import by_blocks
from gyrowheel_core.readings import Readings
from gyrowheel_recording.bags import Recording
from gyrowheel_recording.bags.reader import PAUSE, pauses

Array = NDArray[np.float64]
Times = NDArray[np.floating[Any]]


@dataclass(frozen=True)
class Shortened:
    """Times of a recording whose long pauses are shortened, so that whatever is averaged around one sees it still."""

    begin: Array  # (k,): when what is left out of each pause begins [s]
    left_out: Array  # (k,): how much of it is left out [s]

    @classmethod
    def of(cls, time: Array, step: float) -> Shortened:
        """Shorten the pauses between ascending times (n,) [s] by multiples of `step` [s]: a grid of it stays."""
        found = pauses(time, PAUSE + 2.0 * step)
        # one step less than could be left out, so that rounding puts no sample on the other side of it
        steps = np.floor((found[:, 1] - found[:, 0] - PAUSE) / step) - 1.0
        return cls(found[:, 0] + PAUSE, steps * step)

    def without(self, time: Times) -> Times:
        """Return times as they are where the pauses are shortened; what is left out is where it begins."""
        if not len(self.begin):
            return time
        begun = np.searchsorted(self.begin, time, side="right")
        last = np.maximum(begun - 1, 0)
        before = np.concatenate([[0.0], np.cumsum(self.left_out)])[last]
        passed = before + np.minimum(time - self.begin[last], self.left_out[last])
        return np.where(begun > 0, time - passed, time)

    def recorded(self, time: Times) -> Array:
        """Return times of the recording, given those where its pauses are shortened."""
        before = np.concatenate([[0.0], np.cumsum(self.left_out)])
        place = np.searchsorted(self.begin - before[:-1], time, side="right")
        return np.asarray(time + before[place])


Complex = NDArray[np.complex128]

#: Length of a block [s]: much shorter than a ramp, much longer than a sample.
BLOCK: Final = 0.01
#: Blocks in an average, so that no harmonic of the spin rate passes down to 600 rpm, and from one to the next.
_WEIGHTS: Final = 32
EVERY: Final = 2
_AT_A_TIME = 2048  # blocks
_FULL = 0.5  # of the samples of a block must be there
_GAP = 4.5  # sample periods; over a longer gap the angle may have made any number of turns

#: Columns of the readings by which setups are judged, in their order.
NAMES: Final = (
    "tilt_x", "tilt_y", "coil_voltage_x", "coil_voltage_y", "spin_angle", "spin_rate", "motor_voltage",
    "motor_current",
)  # fmt: skip
TILT: Final = (NAMES[0], NAMES[1])
COIL: Final = (NAMES[2], NAMES[3])


@dataclass(frozen=True)
class Averages:
    """Averages over some tenths of a second; NaN where samples are missing.

    The rates are derivatives of the same averages: the weight is differentiated, never a reading.
    """

    #: Shape (k, 8): means, first and second derivatives of the columns `NAMES` [SI].
    means: Array
    rates: Array
    bends: Array
    #: Columns that were never measured (`blocks_of`) and must not be judged.
    absent: frozenset[str] = frozenset()

    def __len__(self) -> int:
        """Return the number of averages."""
        return len(self.means)

    def changed(self, change: Callable[[Array], Array]) -> Averages:
        """Return the averages of changed columns; the change must be linear."""
        means, rates, bends = (
            _with_twins(change(own), self.absent) for own in (self.means, self.rates, self.bends)
        )
        return Averages(means, rates, bends, self.absent)

    def without(self, *names: str) -> Averages:
        """Return the averages without some columns, as if they had not been measured."""
        return replace(self, absent=self.absent | set(names)).changed(np.copy)

    def parts(self, count: int) -> list[Averages]:
        """Return them in parts of about the same length, one after the other."""
        places = np.array_split(np.arange(len(self)), count)
        return [Averages(self.means[k], self.rates[k], self.bends[k], self.absent) for k in places]

    def measured(self, *names: str) -> bool:
        """Whether all of some columns were measured."""
        return not self.absent & set(names)

    @property
    def tilt(self) -> Complex:
        """Tilt x + i y [rad]."""
        return _pair(self.means, TILT)

    @property
    def tilt_rate(self) -> Complex:
        """Its rate [rad/s]."""
        return _pair(self.rates, TILT)

    @property
    def tilt_acceleration(self) -> Complex:
        """Its acceleration [rad/s^2]."""
        return _pair(self.bends, TILT)

    @property
    def coil(self) -> Complex:
        """Coil voltages x + i y [V]."""
        return _pair(self.means, COIL)

    @property
    def turning(self) -> Array:
        """Rate at which the recorded angle turns [rad/s]."""
        return _column(self.means, "spin_angle")

    @property
    def rate(self) -> Array:
        """Spin rate as recorded [rad/s]."""
        return _column(self.means, "spin_rate")

    @property
    def acceleration(self) -> Array:
        """Rate of the recorded spin rate [rad/s^2]."""
        return _column(self.rates, "spin_rate")

    @property
    def voltage(self) -> Array:
        """Motor voltage [V]."""
        return _column(self.means, "motor_voltage")

    @property
    def current(self) -> Array:
        """Motor current [A]."""
        return _column(self.means, "motor_current")


def averages(blocks: Array, absent: Set[str] = frozenset()) -> Averages:
    """Return the averages over `_WEIGHTS` blocks (m, 8), every `EVERY` blocks; `absent` columns were never measured."""
    if len(blocks) < _WEIGHTS:
        windows = np.zeros((0, len(NAMES), _WEIGHTS))
    else:
        windows = sliding_window_view(blocks, _WEIGHTS, axis=0)[::EVERY]
    means, rates, bends = (windows @ weight for weight in _weights())
    return Averages(means, rates, bends, frozenset(absent))


def never_measured(recording: Recording) -> frozenset[str]:
    """Return which of the columns `NAMES` have no number at all."""
    return frozenset(name for name in NAMES if not np.isfinite(recording.readings[name]).any())


def _with_twins(columns: Array, absent: Set[str]) -> Array:
    """Return columns in which the rate of the angle stands for a speed that was not measured, or the other way."""
    if len(absent & {"spin_angle", "spin_rate"}) == 1:
        angle, rate = NAMES.index("spin_angle"), NAMES.index("spin_rate")
        columns[:, [angle, rate]] = columns[:, [rate if "spin_angle" in absent else angle]]
    return columns


def _column(columns: Array, name: str) -> Array:
    return np.asarray(columns[:, NAMES.index(name)])


def _pair(columns: Array, names: tuple[str, ...]) -> Complex:
    return np.asarray(_column(columns, names[0]) + 1j * _column(columns, names[1]))


@functools.cache
def _weights() -> tuple[Array, Array, Array]:
    """Return the weights of a mean, of its rate and of its acceleration: a Hann window and its derivatives."""
    phase = 2.0 * math.pi * (np.arange(_WEIGHTS) + 0.5) / _WEIGHTS
    turn = 2.0 * math.pi / (_WEIGHTS * BLOCK)
    # by parts: the mean of a derivative is minus that of the values with the derivative of the weight
    return (
        (1.0 - np.cos(phase)) / _WEIGHTS,
        -np.sin(phase) * turn / _WEIGHTS,
        np.cos(phase) * turn**2 / _WEIGHTS,
    )


def blocks_of(recording: Recording, *, angle_scale: float = 1.0, absent: Set[str] = frozenset()) -> Array:
    """Return the means of the columns `NAMES` over blocks of `BLOCK` seconds, (m, 8) [SI].

    The blocks follow each other without a gap, but for what is left out of long pauses (`Shortened`).

    For ``spin_angle`` it is the rate at which the angle turns [rad/s]. Blocks with too few samples are NaN. A column
    that was never measured is zero; of angle and speed, the rate of the one stands for the other.

    `recording`: the recording; samples that lack one of the columns are left out. `angle_scale`: factor of
    the angle before the number of turns is counted: for an angle that is not in radians; `absent`: what
    `never_measured` returns.
    """
    readings = recording.readings.array
    there = Readings.columns([name for name in NAMES if name not in absent])
    finite = by_blocks(
        len(readings), lambda first, last: np.isfinite(readings[first:last, there]).all(axis=1)
    )
    kept = np.flatnonzero(np.concatenate(finite)) if not all(block.all() for block in finite) else None
    time = recording.time if kept is None else recording.time[kept]
    if len(time) < 3:
        return np.zeros((0, len(NAMES)))
    period = float(np.median(np.diff(time), overwrite_input=True))
    shortened = _shortened(recording)
    count = int(shortened.without(time[-1]) / BLOCK)
    edges = np.searchsorted(time, shortened.recorded(BLOCK * np.arange(count + 1) - 0.5 * period))
    samples = np.diff(edges)
    result = np.full((count, len(NAMES)), np.nan)
    full = samples >= _FULL * BLOCK / period
    begin = edges[:-1][full]
    end = np.append(begin[1:], edges[-1])

    def means(first: int, last: int) -> Array:
        # one sample before them, for the first step of the angle; the first of all takes that of the second one
        low, stop = max(begin[first] - 1, 0), end[last - 1]
        high = max(stop, low + 2)
        rows = slice(low, high) if kept is None else kept[low:high]
        columns = readings[rows][:, Readings.columns(NAMES)]
        columns[:, [NAMES.index(name) for name in absent]] = 0.0
        _differentiate(columns, time[low:high], angle_scale, period)
        columns = _with_twins(columns, absent)[begin[first] - low : stop - low]
        sums = np.add.reduceat(columns, begin[first:last] - begin[first], axis=0)
        return np.asarray(sums / (end - begin)[first:last, None])

    if full.any():
        # what lies between a block and the next full one is in the sum: such a block is left out, too
        unbroken = (end - begin == samples[full])[:, None]
        result[full] = np.where(unbroken, np.concatenate(by_blocks(len(begin), means, _AT_A_TIME)), np.nan)
    return result


def _differentiate(columns: Array, time: Array, angle_scale: float, period: float) -> None:
    """Put the rate at which the angle turns in place of the angle; the first row takes that of the next."""
    place, steps = NAMES.index("spin_angle"), np.diff(time)
    turned = np.diff(angle_scale * columns[:, place])
    turned -= 2.0 * math.pi * np.round(turned / (2.0 * math.pi))
    columns[1:, place] = np.where(steps < _GAP * period, turned / steps, np.nan)
    columns[0, place] = columns[1, place]


def block_times(recording: Recording, count: int) -> Array:
    """Return the times at which the first `count` blocks of a recording begin [s]."""
    return _shortened(recording).recorded(BLOCK * np.arange(count))


def block_at(recording: Recording, time: float) -> int:
    """Return the number of the block that begins next to a time [s]."""
    return round(float(_shortened(recording).without(np.array(time))) / BLOCK)


def _shortened(recording: Recording) -> Shortened:
    return Shortened.of(recording.time, EVERY * BLOCK)


def asked_tilt(recording: Recording, count: int) -> Complex | None:
    """Return the tilt that was asked for at `count` averages [rad]; None without setpoints or where all are zero."""
    rows = recording.setpoint
    if len(rows) < 2:
        return None
    at = _middles(recording, count)
    time = recording.seconds(rows["stamp_ns"])
    tilt = np.interp(at, time, rows["tilt_x"]) + 1j * np.interp(at, time, rows["tilt_y"])
    return np.asarray(tilt) if np.isfinite(tilt).all() and np.any(tilt) else None


def asked_speed(recording: Recording, count: int) -> Array | None:
    """Return the spin rate that was asked for at `count` averages [rad/s]; None without setpoints."""
    rows = recording.setpoint
    if len(rows) < 2:
        return None
    speed = np.interp(_middles(recording, count), recording.seconds(rows["stamp_ns"]), rows["spin_rate"])
    return np.asarray(speed) if np.isfinite(speed).all() and np.any(speed) else None


def commanded(recording: Recording, count: int) -> Complex | None:
    """Return the coil voltages that were commanded, at `count` averages [V]; None without commands."""
    rows = recording.given_commands
    if len(rows) < 2:
        return None
    time = recording.seconds(rows["stamp_ns"])
    half, middles = 0.25 * _WEIGHTS * BLOCK, _middles(recording, count)
    begin, end = (np.searchsorted(time, middles + way * half) for way in (-1.0, 1.0))
    total = np.r_[0.0, np.cumsum(rows["coil_voltage_x"] + 1j * rows["coil_voltage_y"])]
    with np.errstate(invalid="ignore", divide="ignore"):
        means = (total[end] - total[begin]) / (end - begin)
    return means if np.any(np.nan_to_num(means)) else None


def _middles(recording: Recording, count: int) -> Array:
    """Return the times of the middles of averages [s], (count,)."""
    return _shortened(recording).recorded(BLOCK * (EVERY * np.arange(count) + 0.5 * _WEIGHTS))
