"""Noise of the rows of a balance: readings, slow drift and accuracy of the balance, and its covariance in linear time.

The drift of a reading is an Ornstein-Uhlenbeck process, which is Markov. The Cholesky factor of its covariance plus a
diagonal therefore need not be formed: its inverse is exactly the recursion of a Kalman filter with one state. The
innovations over their standard deviations are the rows divided by the square root of their covariance.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from gyrowheel_analysis.balance.balance import Balance
from gyrowheel_analysis.balance.instruments import Held, Instruments
from gyrowheel_analysis.channels import Channel
from gyrowheel_analysis.criteria import (
    ANGLE_FLOOR,
    FILTER_SHAPE,
    MODEL_ABSOLUTE,
    MODEL_ANGLE,
    MODEL_RELATIVE,
    MODEL_RIPPLE,
    MODEL_TILT,
    VOLTAGE_FLOOR,
)
from gyrowheel_analysis.reduction.window_fit import resistances
from gyrowheel_analysis.reduction.windows import FORWARD, HARMONICS, MEAN, MODULATION, Windows
from gyrowheel_sim.bench import Bench
from gyrowheel_sim.effects.registry import torque_scale
from gyrowheel_sim.jit import njit

Array = NDArray[np.float64]

_KEPT = 8  # cached scales: an optimiser moves one at a time


class DriftCovariance:
    """Covariance of rows with white noise and one drift: diag(d) + (scale * level)² exp(-|t - t'| / tau).

    `time` (n,) are the times of the rows [s], in any order; `diagonal` (n,) is the variance d of the white noise,
    positive; `level` is the standard deviation of the drift for a scale of one [unit of the rows], `drift_time` its
    correlation time tau [s].
    """

    def __init__(self, time: Array, diagonal: Array, level: float, drift_time: float) -> None:
        self.time = np.asarray(time, dtype=np.float64)
        self.diagonal = np.asarray(diagonal, dtype=np.float64)
        self.level, self.drift_time = level, drift_time
        order = np.argsort(self.time, kind="stable")
        self._order = None if np.array_equal(order, np.arange(len(order))) else order
        after = np.diff(self.time[order], prepend=-math.inf)
        self._fading = np.exp(-after / drift_time)
        # 1 - fading², which rounding would spoil where two rows are close
        self._renewed = -np.expm1(-2.0 * after / drift_time)
        self._sorted = self.diagonal[order]
        self._gains: dict[float, tuple[Array, Array]] = {}

    def __len__(self) -> int:
        """Return the number of rows."""
        return len(self.time)

    def variance(self, scale: float) -> Array:
        """Return the variance of every row, the drift `scale` times as large as stated."""
        return self.diagonal + (scale * self.level) ** 2

    def dense(self, scale: float) -> Array:
        """Return the whole matrix (n, n)."""
        lag = np.abs(self.time[:, None] - self.time[None, :])
        return np.diag(self.diagonal) + (scale * self.level) ** 2 * np.exp(-lag / self.drift_time)

    def whiten(self, rows: Array, scale: float) -> Array:
        """Return rows (n, ...) divided by the square root of their covariance.

        For rows ordered by time that root is the lower Cholesky factor. Other rows are processed in the order of time,
        and each result is put in the place of its row.
        """
        return self._passed(_innovations, rows, scale)

    def whiten_back(self, rows: Array, scale: float) -> Array:
        """Return rows (n, ...) times the transpose of the matrix by which `whiten` multiplies."""
        return self._passed(_innovations_back, rows, scale)

    def _passed(self, recursion: Callable[..., None], rows: Array, scale: float) -> Array:
        """Return rows (n, ...) after one of the two recursions over the windows in the order of time."""
        gain, deviation = self._filter(scale)
        shape = np.shape(rows)
        flat = np.ascontiguousarray(rows, dtype=np.float64).reshape(len(self), math.prod(shape[1:]))
        out = np.empty_like(flat)
        order = np.arange(len(self)) if self._order is None else self._order
        recursion(flat, order, self._fading, gain, deviation, out)
        return out.reshape(shape)

    def of_steps(
        self, left: Array, right: Array, factor: Array, scale: float, pairs: NDArray[np.int64]
    ) -> tuple[Array, Array]:
        """Return products of whitened rows that are zero outside of some windows, in linear time.

        Parameters
        ----------
        left, right : ndarray (n,)
            Two courses over the windows, in the order of time.
        factor : ndarray (n,)
            Scatter by which the whitened rows are divided.
        scale : float
            Scale of the drift.
        pairs : ndarray (m, 2)
            First window, and the one after the last; ascending by the first one, then by the second.

        Returns
        -------
        steps : ndarray (n,)
            Products of both courses from each window on.
        bursts : ndarray (m,)
            Products of both within each pair.
        """
        gain, deviation = self._filter(scale)
        steps, bursts = np.empty((3, len(self))), np.empty(len(pairs))
        weight = 1.0 / (deviation * factor) ** 2
        _steps(left, right, self._fading, gain, weight, steps)
        _bursts(left, right, self._fading, gain, steps, pairs, bursts)
        return steps[0], bursts

    def of_courses(self, courses: Array, left: Array, right: Array, factor: Array, scale: float) -> Array:
        """Return products (m, m, e) of whitened rows that follow courses (n, m, e), without forming these rows.

        One side is the courses times `left` (n,), the other one times `right` (n,); `factor` (n,) is as for `of_steps`.
        """
        if self._order is not None:
            courses, left, right, factor = (own[self._order] for own in (courses, left, right, factor))
        gain, deviation = self._filter(scale)
        return course_products(courses, left, right, self._fading, gain, 1.0 / (deviation * factor) ** 2)

    def shares(self, rows: Array, scale: float) -> Array:
        """Return the part (n,) of chi-squared that belongs to each row, in proportion to its square over its variance.

        Where rows drift together, chi-squared is that of their covariance: it cannot be told apart by row otherwise.
        """
        squares = rows**2 / self.variance(scale)
        total = float(squares.sum())
        return squares * (float(np.sum(self.whiten(rows, scale) ** 2)) / total if total else 0.0)

    def log_determinant(self, scale: float) -> float:
        """Return the logarithm of the determinant of the covariance."""
        return 2.0 * float(np.log(self._filter(scale)[1]).sum())

    def _filter(self, scale: float) -> tuple[Array, Array]:
        """Return gains of the filter and deviations of its innovations."""
        if scale not in self._gains:
            if len(self._gains) >= _KEPT:
                self._gains.pop(next(iter(self._gains)))
            gain, deviation = np.empty(len(self)), np.empty(len(self))
            _steady(self._fading, self._renewed, self._sorted, (scale * self.level) ** 2, gain, deviation)
            self._gains[scale] = gain, deviation
        return self._gains[scale]


def course_products(
    courses: Array, left: Array, right: Array, fading: Array, gain: Array, weight: Array
) -> Array:
    """Return the products of `DriftCovariance.of_courses` for a filter; without a drift it fades at once."""
    out = np.zeros((courses.shape[1], *courses.shape[1:]))
    same = np.array_equal(left, right)
    _products(np.ascontiguousarray(courses), left, right, fading, gain, weight, same, out)
    return out


def precision_root(design: Array) -> Array:
    """Return the lower triangular root of 1 + DᵀD, the precision of coefficients of unit prior deviation."""
    unit = np.eye(design.shape[1])
    try:
        return np.asarray(np.linalg.cholesky(unit + design.T @ design))
    except np.linalg.LinAlgError:  # rows so large that the unit matrix is lost in their squares
        root = np.transpose(np.linalg.qr(np.vstack([unit, design]), mode="r"))
        return np.asarray(root * np.where(np.diag(root) < 0.0, -1.0, 1.0))


class MarginalCost:
    """Minus twice the log likelihood of rows that regressors and drifts of unknown magnitude explain.

    The rows `residual` (N,) are normal with the covariance ``blockdiag(C_1(s), C_2(s), ...) + X Xᵀ``, where X are the
    `regressors` (N, p), each column scaled to one prior standard deviation, and each of the `blocks` C is given with
    the name of its drift. By the Woodbury identity and the matrix determinant lemma no larger matrix is needed than X
    has columns.
    """

    def __init__(
        self, blocks: Sequence[tuple[DriftCovariance, str]], residual: Array, regressors: Array
    ) -> None:
        self._blocks: list[tuple[DriftCovariance, str, Array]] = []
        both = np.column_stack([regressors, residual])
        at = 0
        for block, name in blocks:
            self._blocks.append((block, name, np.ascontiguousarray(both[at : at + len(block)])))
            at += len(block)
        if at != len(both):
            raise ValueError(f"{at} rows in the blocks, {len(both)} in the residual")
        self._size = both.shape[1]
        self._parts: dict[tuple[str, float], tuple[Array, float]] = {}

    def __call__(self, scales: Mapping[str, float]) -> float:
        """Return the cost for scales of the drifts, by name, without the constant N log 2π."""
        gram, log_det = np.zeros((self._size, self._size)), 0.0
        for name in dict.fromkeys(name for _, name, _ in self._blocks):
            own, own_log_det = self._part(name, float(scales[name]))
            gram, log_det = gram + own, log_det + own_log_det
        # Xᵀ C⁻¹ X with the prior, Xᵀ C⁻¹ y, yᵀ C⁻¹ y
        try:
            factor = np.linalg.cholesky(gram[:-1, :-1] + np.eye(self._size - 1))
        except np.linalg.LinAlgError:
            return math.inf  # absurd readings: the regressors are beyond what numbers can tell apart
        along = solve_triangular(factor, gram[:-1, -1], lower=True, check_finite=False)
        log_det += 2.0 * float(np.log(np.diag(factor)).sum())
        return log_det + float(gram[-1, -1] - along @ along)

    def _part(self, name: str, scale: float) -> tuple[Array, float]:
        """Return the products of regressors and residual, and the log-determinant, of the blocks of one drift."""
        key = name, scale
        if key not in self._parts:
            gram, log_det = np.zeros((self._size, self._size)), 0.0
            for block, own, both in self._blocks:
                if own == name:
                    white = block.whiten(both, scale)
                    gram, log_det = gram + white.T @ white, log_det + block.log_determinant(scale)
            if len(self._parts) >= _KEPT * len(self._blocks):
                self._parts.pop(next(iter(self._parts)))
            self._parts[key] = gram, log_det
        return self._parts[key]


@njit(cache=True, error_model="numpy")
def _steady(fading: Any, renewed: Any, diagonal: Any, variance: float, gain: Any, deviation: Any) -> None:
    """Fill the gains and the deviations of the innovations of a drift of some variance."""
    left = variance  # of the drift, given the rows so far
    for k in range(len(diagonal)):
        ahead = fading[k] * fading[k] * left + renewed[k] * variance
        total = ahead + diagonal[k]
        gain[k] = ahead / total
        deviation[k] = math.sqrt(total)
        left = ahead * diagonal[k] / total


@njit(cache=True, error_model="numpy")
def _innovations(rows: Any, order: Any, fading: Any, gain: Any, deviation: Any, out: Any) -> None:
    """Fill `out` with the innovations of every column over their deviations."""
    columns = rows.shape[1]
    level = np.zeros(columns)
    for k in range(len(order)):
        place = order[k]
        for c in range(columns):
            ahead = fading[k] * level[c]
            new = rows[place, c] - ahead
            out[place, c] = new / deviation[k]
            level[c] = ahead + gain[k] * new


@njit(cache=True, error_model="numpy")
def _innovations_back(rows: Any, order: Any, fading: Any, gain: Any, deviation: Any, out: Any) -> None:
    """Fill `out` with the rows times the transpose of the matrix by which `_innovations` multiplies."""
    columns = rows.shape[1]
    level = np.zeros(columns)
    for k in range(len(order) - 1, -1, -1):
        place = order[k]
        for c in range(columns):
            new = rows[place, c] / deviation[k] + gain[k] * level[c]
            out[place, c] = new
            level[c] = fading[k] * (level[c] - new)


@njit(cache=True, error_model="numpy")
def _products(
    courses: Any, left: Any, right: Any, fading: Any, gain: Any, weight: Any, same: bool, out: Any
) -> None:
    """Add to `out` the products of the innovations of courses times `left` and times `right`; `same`: these are one."""
    count, kinds, events = courses.shape
    one, other = np.zeros((kinds, events)), np.zeros((kinds, events))  # levels of the drift
    new, further = np.empty((kinds, events)), np.empty((kinds, events))
    for k in range(count):
        f, g, w = fading[k], gain[k], weight[k]
        for i in range(kinds):
            for e in range(events):
                ahead = f * one[i, e]
                new[i, e] = courses[k, i, e] * left[k] - ahead
                one[i, e] = ahead + g * new[i, e]
            if not same:
                for e in range(events):
                    ahead = f * other[i, e]
                    further[i, e] = courses[k, i, e] * right[k] - ahead
                    other[i, e] = ahead + g * further[i, e]
        second = new if same else further
        for i in range(kinds):
            for j in range(kinds):
                for e in range(events):
                    out[i, j, e] += w * new[i, e] * second[j, e]


@njit(cache=True, error_model="numpy")
def _steps(left: Any, right: Any, fading: Any, gain: Any, weight: Any, out: Any) -> None:
    """Fill `out` with the products of the innovations of two inputs from row k on, and how they grow with the levels.

    From row k on they are a l m + p l + q m + c for levels l and m of the two before it: `out` has c, p and q.
    """
    a = p = q = c = 0.0
    for k in range(len(left) - 1, -1, -1):
        f, g, w, u, v = fading[k], gain[k], weight[k], left[k], right[k]
        kept = f * (1.0 - g)
        c = w * u * v + a * g * g * u * v + p * g * u + q * g * v + c
        p, q = -w * f * v + a * kept * g * v + p * kept, -w * f * u + a * kept * g * u + q * kept
        a = w * f * f + a * kept * kept
        out[0, k], out[1, k], out[2, k] = c, p, q


@njit(cache=True, error_model="numpy")
def _bursts(left: Any, right: Any, fading: Any, gain: Any, steps: Any, pairs: Any, out: Any) -> None:
    """Fill `out` with the products of two inputs that are zero before the first row of a pair, and from its second on.

    Each is the difference of two steps: the mixed products follow from the levels at which the first one arrives.
    """
    first = at = -1
    one = other = 0.0
    for k in range(len(pairs)):
        if pairs[k, 0] != first:
            first = at = pairs[k, 0]
            one = other = 0.0
        while at < pairs[k, 1]:
            kept = fading[at] * (1.0 - gain[at])
            one = kept * one + gain[at] * left[at]
            other = kept * other + gain[at] * right[at]
            at += 1
        out[k] = steps[0, first]
        if at < len(left):
            out[k] -= steps[0, at] + steps[1, at] * one + steps[2, at] * other


def average_covariance(
    balance: Balance, predicted: Array, channel: Channel, row: str, bench: Bench | None = None
) -> DriftCovariance:
    """Return the covariance of one row of the averages, given the predicted rows.

    `bench` is that of the noise, by default that of the balance.

    Raises
    ------
    KeyError
        If the channel's quantity has no average.
    """
    return _AVERAGES[channel.quantity](
        balance, balance.bench if bench is None else bench, np.abs(predicted[balance.row(row)])
    )


def amplitude_variance(
    balance: Balance,
    bench: Bench,
    predicted: Array,
    channel: Channel,
    lateness: Mapping[str, float] | None = None,
) -> Array:
    """Return the variance of each part of an amplitude in every window.

    `predicted` (N,) are the rows of the balance; `bench` is that of the noise, whose values may differ from those of
    the balance's bench. `lateness` are unstated delays of readings [s], by channel; the shape of the filter that causes
    them is unknown.
    """
    size = np.hypot(*(predicted[balance.row(row)] for row in channel.rows))
    variance = np.asarray(_AMPLITUDES[channel.quantity](balance, bench, size, channel.order))
    if balance.phase_error:
        turns = channel.order or bench.value("motor_ripple_order")
        variance = variance + (turns * balance.phase_error * size) ** 2
    if not lateness or channel.quantity != "coil_torque":
        return variance
    w, order = balance.windows, channel.order
    turn = order * w.mean_spin
    wobble = np.abs(w.tilt_harmonics[:, HARMONICS.index(order)] @ MEAN[:MODULATION])
    for reading, torque in (("coil_voltage", size), ("tilt", _resistance(balance, bench, order) * wobble)):
        variance = variance + (FILTER_SHAPE * np.abs(turn * lateness.get(reading, 0.0)) ** 3 * torque) ** 2
    return variance


def _coil_average(balance: Balance, bench: Bench, rows: Array) -> DriftCovariance:
    v, w = balance.bench.value, balance.windows
    momentum = bench.precession_inertia * w.mean_spin * _to_row(balance, bench, "coil_constant")
    slew = momentum * np.abs(w.mean_tilt_rate)
    white = (
        v("coil_constant") * w.noise("coil_voltage_noise")
    ) ** 2 / w.samples + momentum**2 * w.tilt_rate_variance
    size, level = np.maximum(rows, slew), v("coil_constant") * v("coil_voltage_drift")
    floor = _absolute(balance) ** 2 + (MODEL_TILT * size) ** 2
    return DriftCovariance(w.middle, white + floor, level, v("drift_time"))


def _motor_torque(balance: Balance, bench: Bench, rows: Array) -> DriftCovariance:
    v, w = balance.bench.value, balance.windows
    torque, floor = _spin_acceleration(balance, bench)
    scaled = _to_row(balance, bench, "motor_constant") ** 2
    white = (v("motor_constant") * w.noise("motor_current_noise")) ** 2 / w.samples + scaled * torque
    level = v("motor_constant") * v("motor_current_drift")
    return DriftCovariance(w.middle, white + scaled * floor, level, v("drift_time"))


def _motor_voltage(balance: Balance, bench: Bench, rows: Array) -> DriftCovariance:
    v, w = balance.bench.value, balance.windows
    torque, floor = _spin_acceleration(balance, bench)
    per_torque = bench.value("motor_resistance") / bench.value("motor_constant")
    white = w.noise("motor_voltage_noise") ** 2 / w.samples + per_torque**2 * torque
    white = white + (bench.value("motor_constant") * w.noise("spin_rate_noise")) ** 2 / w.samples
    return DriftCovariance(w.middle, white + floor * per_torque**2, v("motor_voltage_drift"), v("drift_time"))


def _spin_acceleration(balance: Balance, bench: Bench) -> tuple[Array, Array]:
    """Return the variances of the motor's torque from the noise of the acceleration, and of the balance itself."""
    w, inertia = balance.windows, bench.axial_inertia
    floor = _absolute(balance) ** 2 + (4.0 * MODEL_RELATIVE * inertia * np.abs(w.mean_spin_acceleration)) ** 2
    return inertia**2 * w.spin_acceleration_variance, floor


def _to_row(balance: Balance, bench: Bench, constant: str) -> float:
    """Return the factor from a torque on a bench to its row: the reading times the constant of the balance's bench."""
    return balance.bench.value(constant) / bench.value(constant)


def _coil_amplitude(balance: Balance, bench: Bench, size: Array, order: int) -> Array:
    w, constant = balance.windows, balance.bench.value("coil_constant")
    own = Instruments.of(bench.values(), {})
    # what a filter takes from the tilt is put back with its noise
    shown = own.held("coil_voltage", order, w.mean_spin) / own.smooth("tilt", order, w.mean_spin)
    stiff = _resistance(balance, bench, order) * np.abs(shown) * _to_row(balance, bench, "coil_constant")
    white = (constant * w.noise("coil_voltage_noise")) ** 2 + (stiff * w.noise("tilt_noise")) ** 2
    white = white * w.harmonic_variance[:, FORWARD.index(order)] / w.samples
    hum = w.hum_variance[:, :, FORWARD.index(order)]
    white = white + stiff**2 * hum[:, 0] + constant**2 * hum[:, 1]
    white = white + w.leakage_variance[:, FORWARD.index(order)]
    return np.asarray(white + _absolute(balance) ** 2 + (MODEL_RELATIVE * size) ** 2)


def _resistance(balance: Balance, bench: Bench, order: int) -> Array:
    """Return the torque of a tilt once or twice a revolution over the tilt [N m/rad]."""
    return np.abs(resistances(bench, balance.windows.mean_spin)[FORWARD.index(order)])


def _angle_amplitude(balance: Balance, bench: Bench, size: Array, order: int) -> Array:
    w = balance.windows
    # the two signs of a harmonic of a real reading share its noise
    white = 0.5 * w.noise("spin_angle_noise") ** 2 * w.harmonic_variance[:, FORWARD.index(order)] / w.samples
    return np.asarray(white + ANGLE_FLOOR**2 + (MODEL_ANGLE * size) ** 2)


def _shaft_amplitude(balance: Balance, bench: Bench, size: Array, order: int) -> Array:
    w, inertia = balance.windows, balance.bench.axial_inertia
    speed, current = _ripple_readings(balance)
    current = current / _ripple_shown(bench, "motor_current", w) ** 2
    swing = inertia * bench.value("motor_ripple_order") * w.mean_spin
    constant = bench.value("motor_constant") * inertia / bench.axial_inertia
    floor = torque_scale(balance.bench) * np.where(w.moving, MODEL_RIPPLE, MODEL_ABSOLUTE)
    return np.asarray(swing**2 * speed + constant**2 * current + floor**2)


def _winding_amplitude(balance: Balance, bench: Bench, size: Array, order: int) -> Array:
    v, w, resistance = bench.value, balance.windows, balance.bench.value("motor_resistance")
    speed, current = _ripple_readings(balance)
    voltage = w.noise("motor_voltage_noise") ** 2 / (2.0 * w.samples)
    voltage = voltage / _ripple_shown(bench, "motor_voltage", w) ** 2 + v("motor_constant") ** 2 * speed
    voltage = voltage * (_ripple_shown(bench, "motor_current", w) * resistance / v("motor_resistance")) ** 2
    return np.asarray(voltage + resistance**2 * current + VOLTAGE_FLOOR)


def _ripple_shown(bench: Bench, reading: Held, windows: Windows) -> Any:
    """Return the size of a reading at the order of the motor's ripple, over the true one."""
    own = Instruments.of(bench.values(), {})
    return np.abs(own.held(reading, own.ripple_order, windows.mean_spin))


def _ripple_readings(balance: Balance) -> tuple[Array, Array]:
    """Return the variances of the amplitudes of spin rate [(rad/s)²] and motor current [A²]."""
    w = balance.windows
    half = 2.0 * w.samples
    return w.noise("spin_rate_noise") ** 2 / half, w.noise("motor_current_noise") ** 2 / half


def _absolute(balance: Balance) -> float:
    return torque_scale(balance.bench) * MODEL_ABSOLUTE


#: By the channel's quantity.
_AVERAGES = {"coil_torque": _coil_average, "motor_torque": _motor_torque, "motor_voltage": _motor_voltage}
_AMPLITUDES = {
    "coil_torque": _coil_amplitude,
    "shaft_torque": _shaft_amplitude,
    "winding_voltage": _winding_amplitude,
    "encoder_angle": _angle_amplitude,
}
