"""The instant at which something changed, from the samples themselves.

Windows are seconds long, samples are finer. The integral of the torques of coils and motor is angular momentum: a
torque that begins bends the difference of the two, which is as quiet as the readings of tilt and speed. A reading of
the motor that shifts makes a jump in the balance of its voltages, an encoder that slips one in the angle.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gyrowheel_analysis.criteria import ONSET_GAIN
from gyrowheel_analysis.reduction.samples import Array, Samples
from gyrowheel_core.readings import Readings
from gyrowheel_recording.bags.reader import pauses
from gyrowheel_sim.bench import Bench

#: Samples that are averaged into one point.
_BLOCK = 8
_STEP = 0.01  # s between the instants that are tried
_BESIDE = 3.0  # s of samples looked at on either side
_FEWEST = 100  # points
_LATE = 1.0e-3  # s; largest unstated delay of a reading
#: Part of the square of a change that nothing else explains, below which the change cannot be identified.
_SHARED = 1.0e-9


@dataclass(frozen=True)
class _Series:
    """A series that is quiet except for the change.

    `time` [s] and `values` are (n,); `beside` (n, k) are other influences with the prior deviations `known` (k,) of
    their shares, infinite where unknown; `change` (n,) is the change per unit, of the values or, if `of_rate`, of their
    rate: the values then bend instead of jumping.
    """

    time: Array
    values: NDArray[np.complex128]
    beside: NDArray[np.complex128]
    known: Array
    change: NDArray[np.complex128]
    of_rate: bool


def onset(
    data: Samples,
    bench: Bench,
    quantities: Sequence[str],
    begin: float,
    end: float,
    other: float | None = None,
) -> tuple[float, float] | None:
    """Return the instant at which quantities changed, and its standard error [s]; None where the samples hide it.

    `quantities` are one of `fitting.events.QUANTITIES`, or both axes of the same. They changed between `begin` and
    `end` and, if given, the opposite way at the time `other`, before or after [s].
    """
    i, j = np.searchsorted(data.time, (begin - _BESIDE, end + _BESIDE))
    count = (j - i) // _BLOCK
    if count < _FEWEST or len(pauses(data.time[i:j])):
        return None  # no momentum can be integrated over a pause, which may last for years
    series = _series(data, bench, quantities[0], int(i), int(i + count * _BLOCK))
    if series is None:
        return None
    at = np.arange(max(begin, series.time[2]), min(end, series.time[-3]), _STEP)
    if len(at) < 2:
        return None
    points = len(series.time)
    beside = np.vstack([series.beside, np.diag(_rough(series.values) / series.known)])
    size = np.linalg.norm(beside, axis=0)
    basis, _ = np.linalg.qr(beside / np.where(size > 0.0, size, 1.0))

    def left_of(rows: NDArray[np.complex128]) -> NDArray[np.complex128]:
        """Return rows (n,) without all influences except the change, with their priors."""
        padded = np.concatenate([rows, np.zeros(len(basis) - points)])
        return padded - basis @ (basis.conj().T @ padded)

    values = left_of(series.values)
    changes = _Changes.of(series, at)
    # projected columns are needed for their sizes alone: the projected values are orthogonal to the removed parts
    rows = np.column_stack([values[:points], basis[:points]])
    along, whole = changes.products(rows), changes.squares()
    back: NDArray[np.complex128] | None = None
    if other is not None:
        ended = _Changes.of(series, np.array([other]))
        back = ended.column(0)
        along = along - ended.products(rows)
        whole = whole + ended.squares() - 2.0 * changes.products(back[:, None])[:, 0].real
    along, shared = along[:, 0].conj(), (np.abs(along[:, 1:]) ** 2).sum(axis=1)
    if len(quantities) == 1:
        along = np.real(along)
    square = np.where(whole - shared > _SHARED * whole, whole - shared, np.inf)
    gains = np.abs(along) ** 2 / square
    best = int(np.argmax(gains))
    column = changes.column(best) - (0.0 if back is None else back)
    left = (values - left_of(column) * along[best] / square[best])[:points]
    noise = _noise(left)
    # a maximum at an end of the range is something else
    if gains[best] < ONSET_GAIN * noise or not 0 < best < len(at) - 1:
        return None
    likely = gains > gains[best] - noise
    return float(at[best]), max(0.5 * float(np.count_nonzero(likely)) * _STEP, 2.0 * _STEP)


@dataclass(frozen=True)
class _Changes:
    """The change of a series, per unit, from each of some instants on: columns that are formed one by one only.

    `unit` (n,) is what each point adds, to its value or, if `of_rate`, to that of all later ones; `place` (m,) are the
    first points after the instants, which have `part` (m,) of it.
    """

    unit: NDArray[np.complex128]
    of_rate: bool
    place: NDArray[np.intp]
    part: Array

    @classmethod
    def of(cls, series: _Series, at: Array) -> _Changes:
        """Return the changes from the instants `at` (m,) [s] on."""
        step = np.maximum(np.diff(series.time, prepend=series.time[0]), 1.0e-9)
        place = np.minimum(np.searchsorted(series.time, at, side="right"), len(step) - 1)
        part = np.clip((series.time[place] - at) / step[place], 0.0, 1.0)
        return cls(series.change * step if series.of_rate else series.change, series.of_rate, place, part)

    def column(self, number: int) -> NDArray[np.complex128]:
        """Return one of the columns (n,)."""
        on = np.zeros(len(self.unit))
        on[self.place[number]] = self.part[number]
        on[self.place[number] + 1 :] = 1.0
        return np.cumsum(self.unit * on) if self.of_rate else self.unit * on

    def products(self, rows: NDArray[np.complex128]) -> NDArray[np.complex128]:
        """Return the inner products (m, k) of rows (n, k) with the columns."""
        weights = rows.conj()
        if self.of_rate:
            weights = _from_end(weights)
        terms = weights * self.unit[:, None]
        return _from_end(terms)[self.place] - (1.0 - self.part[:, None]) * terms[self.place]

    def squares(self) -> Array:
        """Return the squares of the lengths of the columns (m,)."""
        if not self.of_rate:
            own = np.abs(self.unit) ** 2
            return np.asarray(_from_end(own)[self.place] - (1.0 - self.part**2) * own[self.place])
        total = np.cumsum(self.unit)
        total -= total.mean()
        before = total[self.place] - self.part * self.unit[self.place]
        later = len(total) - self.place
        squares, sums = _from_end(np.abs(total) ** 2)[self.place], _from_end(total)[self.place]
        return np.asarray(squares - 2.0 * (before.conj() * sums).real + later * np.abs(before) ** 2)


def _from_end(values: Any) -> Any:
    """Return the sums of values (n, ...) from each on to the last."""
    return np.cumsum(values[::-1], axis=0)[::-1]


def _noise(left: NDArray[np.complex128]) -> float:
    """Return the variance of one part of residuals, times their correlation length."""
    centred = left - left.mean()
    spectrum = np.abs(np.fft.fft(centred, 2 * len(left))) ** 2
    likeness = np.real(np.fft.ifft(spectrum))[: len(left) // 4]
    if likeness[0] <= 0.0:
        return 1e-300
    likeness = likeness / likeness[0]
    ends = np.flatnonzero(likeness < 0.05)
    alike = 1.0 + 2.0 * float(likeness[1 : ends[0] if len(ends) else None].sum())
    return 0.5 * float(np.mean(np.abs(centred) ** 2)) * max(alike, 1.0)


def _rough(values: NDArray[np.complex128]) -> float:
    """Return the standard deviation of the noise of otherwise smooth values."""
    return float(np.sqrt(np.mean(np.abs(np.diff(values, 2)) ** 2) / 6.0))


def _mean(values: Any) -> Any:
    """Return the means of blocks of samples, along the first axis."""
    return values.reshape(-1, _BLOCK, *values.shape[1:]).mean(axis=1)


def _series(data: Samples, bench: Bench, quantity: str, i: int, j: int) -> _Series | None:
    """Return the series that shows the change of a quantity, from samples i .. j-1; None without such a series."""
    make: Callable[[Array, Readings, Bench, str, Any], _Found | None]
    if quantity in ("motor_current", "motor_voltage", "winding_resistance", "motor_constant"):
        make = _voltages
    elif quantity == "encoder_zero":
        make = _angle
    elif quantity in ("spin_torque", "spin_torque_by_speed"):
        make = _spin_momentum
    else:
        make = _tilt_momentum
    time, own = data.time[i:j], data.readings[i:j]
    turn = np.exp(1j * own.spin_angle)
    x = (time - time.mean()) / (time[-1] - time[0])
    shared = [np.ones_like(time), x, turn, turn.conj(), turn**2, turn.conj() ** 2]
    found = make(time, own, bench, quantity, turn)
    if found is None:
        return None
    values, change, of_rate, further = found
    columns, known = zip(*further, strict=True)
    return _Series(
        time=_mean(time),
        values=_mean(values).astype(np.complex128),
        beside=_mean(np.column_stack([*shared, *columns])).astype(np.complex128),
        known=np.array([*(math.inf for _ in shared), *known]),
        change=_mean(change).astype(np.complex128),
        of_rate=of_rate,
    )


#: Values, the change per unit, whether that is of their rate, and other influences with their prior deviations.
_Found = tuple[Any, Any, bool, list[tuple[Any, float]]]


def _voltages(time: Array, own: Readings, bench: Bench, quantity: str, turn: Any) -> _Found:
    """Return the voltage of the motor less the voltage that current and speed need."""
    v = bench.value
    volts = (
        own.motor_voltage - v("motor_resistance") * own.motor_current - v("motor_constant") * own.spin_rate
    )
    back_emf = (_smooth(own.spin_rate), 0.05 * v("motor_constant"))
    if quantity == "winding_resistance":
        return volts, v("motor_resistance") * own.motor_current, False, [back_emf]
    winding = (_smooth(own.motor_current), 0.3 * v("motor_resistance"))
    if quantity == "motor_constant":
        return volts, v("motor_constant") * _smooth(own.spin_rate), False, [back_emf, winding]
    return volts, np.ones_like(volts), False, [back_emf, winding]


def _angle(time: Array, own: Readings, bench: Bench, quantity: str, turn: Any) -> _Found:
    """Return the angle less the integral of the speed."""
    turned = np.cumsum(own.spin_rate * _steps(time))
    angle = np.unwrap(own.spin_angle)
    slow = time - time.mean()
    return angle - turned, np.ones_like(angle), False, [(slow**2, math.inf), (slow**3, math.inf)]


def _spin_momentum(time: Array, own: Readings, bench: Bench, quantity: str, turn: Any) -> _Found:
    """Return the angular momentum of the spin less the integral of the motor's torque."""
    steps, spin = _steps(time), _smooth(own.spin_rate)
    given = np.cumsum(bench.value("motor_constant") * own.motor_current * steps)
    tilted = np.hypot(own.tilt_x, own.tilt_y) ** 2
    drag = bench.value("bearing_coulomb") / bench.value("spin_rate_reference")
    further = [
        (spin, 0.02 * bench.axial_inertia),
        (np.cumsum((spin - spin.mean()) * steps), 10.0 * drag),
        (np.cumsum(tilted * steps), math.inf),
        (tilted, math.inf),
    ]
    change = spin if quantity == "spin_torque_by_speed" else np.ones_like(spin)
    return bench.axial_inertia * own.spin_rate - given, change, True, further


def _tilt_momentum(time: Array, own: Readings, bench: Bench, quantity: str, turn: Any) -> _Found | None:
    """Return the angular momentum across the case axis less the integral of the coils' torque, times -i."""
    v, steps, spin = bench.value, _steps(time), _smooth(own.spin_rate)
    z = np.tan(own.tilt_x) + 1j * np.tan(own.tilt_y)
    axis = z / np.sqrt(1.0 + np.abs(z) ** 2)
    square, inertia, across = np.abs(z) ** 2, bench.precession_inertia, v("rotor_inertia_x")
    rate = np.gradient(_smooth(z), time)
    coil = v("coil_constant") * (own.coil_voltage_x + 1j * own.coil_voltage_y)
    changes = {
        "torque_x": np.ones_like(z),
        "torque_y": np.full_like(z, 1j),
        "coil_voltage_x": np.ones_like(z),
        "coil_voltage_y": np.full_like(z, 1j),
        "torque_along_tilt": z,
        "torque_across_tilt": 1j * z * spin,
        "coil_gain": coil,
        "coil_gain_x": coil.real + 0j,
        "coil_gain_y": 1j * coil.imag,
    }
    jumps = {"tilt_reading_x": 1j * inertia * spin, "tilt_reading_y": -inertia * spin}
    if quantity not in changes | jumps:
        return None
    values = np.cumsum(coil * steps) + 1j * inertia * spin * axis - across * rate
    further = [
        (np.cumsum(z * steps), math.inf),
        (np.cumsum(spin**2 * z * steps), math.inf),
        (np.cumsum(spin * z * steps), math.inf),
        (np.cumsum(square * z * steps), math.inf),
        (spin * axis, 0.02 * inertia),
        (spin * axis.conj(), 0.02 * inertia),
        # the motor drives along the case axis, the drag acts along that of the rotor
        (np.cumsum(np.gradient(spin, time) * axis * steps), inertia),
        (spin * axis * square, inertia),
        (rate, 0.3 * across),
        # readings that are late
        (inertia * spin * rate, _LATE),
        (coil, _LATE),
        *(
            (wave * tilt, math.inf)
            for wave in (turn, turn.conj(), turn**2, turn.conj() ** 2)
            for tilt in (z, z.conj())
        ),
    ]
    return values, (changes | jumps)[quantity], quantity in changes, further


def _steps(time: Array) -> Array:
    """Return the intervals that end with the samples [s]."""
    return np.diff(time, prepend=2.0 * time[0] - time[1])


def _smooth(values: Any) -> Any:
    """Return the running mean of values over 20 ms."""
    return np.convolve(np.pad(values, 20, mode="edge"), np.full(41, 1.0 / 41.0), mode="valid")
