"""Drag estimates of the published ground test, one per hold: notch-filtered mean voltages and simulated torques."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from gyrowheel_analysis.balance.balance import ActiveEffect, Balance
from gyrowheel_analysis.model import Model
from gyrowheel_analysis.reduction import LONGEST, NEEDED, SETTLING, SPIN_SETTLING, Samples, reduce
from gyrowheel_control.plans.plan import HOLD, SETPOINT_DTYPE
from gyrowheel_core.readings import Readings
from gyrowheel_core.units import DEG

Array = NDArray[np.float64]

#: Readings that are filtered; `_TILT`, `_DC` and `_CURRENT` are places among them.
_FILTERED = ("tilt_x", "tilt_y", "coil_voltage_x", "coil_voltage_y", "motor_voltage", "motor_current")
_COLUMNS = np.array(Readings.columns(_FILTERED))
_TILT, _DC, _CURRENT = slice(0, 2), slice(2, 5), 5
_NEEDED_COLUMNS = Readings.columns(NEEDED)
_RADIUS = 0.97  # of the notch's poles: 10 Hz wide, settles in 0.1 s
_NOTCH_SETTLING = 0.15  # s
_UPDATE, _SELDOM = 0.5, 5.0  # s between two estimates of one hold, at its beginning and in the long run
_SHARE = 0.1  # of a hold's length that is new in the next estimate


@dataclass(frozen=True)
class Estimate:
    """One drag estimate; the fields of the DragEstimate message [SI].

    Torques are those of coils (x, y) and motor, in case axes. `measured_torque` and `residual` are NaN
    until the model holds a calibrated constant of coils (x, y) or motor.
    """

    stamp_ns: int
    segment: int
    settled: bool
    duration: float
    tilt_x: float
    tilt_y: float
    spin_rate: float
    dc_voltage: Array
    dc_voltage_std: Array
    voltage_increment: Array
    measured_torque: Array
    measured_torque_std: Array
    simulated_torque: Array
    residual: Array


@njit(cache=True, error_model="numpy")
def notch(values: Any, columns: Any, rate: Any, period: float, radius: float, state: Any, out: Any) -> None:
    """Filter `values` (m, n) in its `columns` through notches at once and twice the tracked spin rate.

    Parameters
    ----------
    values, columns : ndarray
        Readings (m, n) and the k columns to filter.
    rate : ndarray (m,)
        Spin rate [rad/s]; the tracked rate is its first-order low-pass, kept in the last element of `state`.
    period, radius : float
        Sampling interval [s] and radius of the poles.
    state : ndarray (2 * 2 * k + 1,)
        Filter memory; all NaN before the first sample.
    out : ndarray (m, k)
        Filtered values.
    """
    k = len(columns)
    smooth = 1.0 - math.exp(-2.0 * math.pi * 5.0 * period)
    for i in range(len(values)):
        first = math.isnan(state[4 * k])
        if first:
            state[4 * k] = rate[i]
        state[4 * k] += smooth * (rate[i] - state[4 * k])
        for c in range(k):
            x = values[i, columns[c]]
            for order in range(2):
                cosine = math.cos((order + 1) * state[4 * k] * period)
                # unit gain at zero frequency
                gain = (1.0 - 2.0 * radius * cosine + radius * radius) / (2.0 - 2.0 * cosine)
                at = 4 * c + 2 * order
                if first:  # start in the steady state of a constant input
                    state[at + 1] = x * (gain - radius * radius)
                    state[at] = x * (1.0 - gain)
                y = gain * x + state[at]
                state[at] = -2.0 * cosine * gain * x + 2.0 * radius * cosine * y + state[at + 1]
                state[at + 1] = gain * x - radius * radius * y
                x = y
            out[i, c] = x


class _Setpoint(NamedTuple):
    """One setpoint: a row of `SETPOINT_DTYPE`."""

    stamp_ns: int
    segment: int
    phase: int
    tilt_x: float
    tilt_y: float
    tilt_rate_x: float
    tilt_rate_y: float
    spin_rate: float
    spin_acceleration: float


@dataclass
class _Hold:
    """The current hold: sums over all of it, and the samples whose windows are not final yet."""

    setpoint: _Setpoint
    start: float  # s, when the motion has settled
    due: float  # s, when the next estimate is due
    first: float = math.nan
    last: float = math.nan
    count: int = 0
    filtered: Array = field(default_factory=lambda: np.zeros(len(_COLUMNS)))  # sum
    spin: float = 0.0  # sum
    torque: Array = field(default_factory=lambda: np.zeros(3))  # simulated, times the length of its windows
    length: float = 0.0  # of those windows [s]
    times: list[Array] = field(default_factory=list)
    readings: list[Array] = field(default_factory=list)

    def add(self, time: Array, readings: Readings, filtered: Array) -> None:
        """Take samples."""
        if not self.count:
            self.first = float(time[0])
        self.last = float(time[-1])
        self.count += len(time)
        self.filtered += filtered.sum(axis=0)
        self.spin += float(readings.spin_rate.sum())
        self.times.append(time)
        self.readings.append(readings.array)


class DragEstimator:
    """Turns samples and setpoints into drag estimates, block by block.

    Parameters
    ----------
    model : Model
        The model whose torques are simulated.
    """

    def __init__(self, model: Model) -> None:
        self._model = model
        self._bench = model.bench
        self._effects = [ActiveEffect(model.library[name], values) for name, values in model.effects.items()]
        self._state = np.full(4 * len(_COLUMNS) + 1, math.nan)
        self._setpoints: deque[_Setpoint] = deque()
        self._hold: _Hold | None = None
        self._spin_before: float | None = None
        self._reference: Array | None = None

    def setpoint(self, stamp_ns: int, segment: int, phase: int, values: Sequence[float]) -> None:
        """Take a setpoint: tilt_x, tilt_y, their rates, spin rate and acceleration; stamps must ascend."""
        self._setpoints.append(_Setpoint(stamp_ns, segment, phase, *values))

    def add_block(self, stamps_ns: NDArray[np.int64], readings: Readings) -> list[Estimate]:
        """Take consecutive samples and return the estimates that they complete.

        Parameters
        ----------
        stamps_ns : ndarray (m,)
            Sampling instants [ns].
        readings : Readings
            Readings (m) [SI]. A sample without one of `NEEDED` (not finite) counts as lost.
        """
        whole = np.asarray(np.isfinite(readings.array[:, _NEEDED_COLUMNS]).all(axis=1))
        if not whole.all():  # a filter never recovers from NaN
            stamps_ns, readings = stamps_ns[whole], readings[whole]
        filtered = np.empty((len(readings), len(_COLUMNS)))
        notch(
            readings.array,
            _COLUMNS,
            readings.spin_rate,
            self._bench.sample_period,
            _RADIUS,
            self._state,
            filtered,
        )
        estimates: list[Estimate] = []
        at = 0
        while at < len(stamps_ns):
            # a setpoint that begins within the block splits it
            stop = len(stamps_ns)
            if self._setpoints and self._setpoints[0].stamp_ns <= stamps_ns[at]:
                estimates += self._take(self._setpoints.popleft())
                continue
            if self._setpoints:
                stop = min(stop, int(np.searchsorted(stamps_ns, self._setpoints[0].stamp_ns)))
            if self._hold is not None:
                time = np.asarray(stamps_ns[at:stop] * 1e-9, dtype=np.float64)
                keep = time >= self._hold.start
                if keep.any():
                    self._hold.add(time[keep], readings[at:stop][keep], filtered[at:stop][keep])
                    if time[-1] >= self._hold.due:
                        step = _SHARE * (self._hold.last - self._hold.first)
                        self._hold.due = self._hold.last + min(max(step, _UPDATE), _SELDOM)
                        estimates += self._estimate(self._hold, settled=False)
            at = stop
        return estimates

    def finish(self) -> list[Estimate]:
        """Return the estimate of the current hold, at the end of a test."""
        return self._end()

    def _take(self, setpoint: _Setpoint) -> list[Estimate]:
        hold, spin = setpoint.phase == HOLD, float(setpoint.spin_rate)
        if self._hold is not None and hold and setpoint.segment == self._hold.setpoint.segment:
            return []
        estimates = self._end()
        turning = math.hypot(setpoint.tilt_rate_x, setpoint.tilt_rate_y)
        if hold and turning < 0.1 * DEG and abs(setpoint.spin_acceleration) < 0.5:
            changed = self._spin_before is not None and abs(spin - self._spin_before) > 2.0
            start = setpoint.stamp_ns * 1e-9 + (SPIN_SETTLING if changed else SETTLING)
            self._hold = _Hold(setpoint, start, start + _UPDATE)
        if hold:
            self._spin_before = spin
        return estimates

    def _end(self) -> list[Estimate]:
        hold, self._hold = self._hold, None
        return [] if hold is None else self._estimate(hold, settled=True)

    def _simulated(self, hold: _Hold) -> Array:
        """Return the torques that the motion needs by the model, averaged over the windows of a hold."""
        time, readings = np.concatenate(hold.times), np.vstack(hold.readings)
        # old samples are reduced once and dropped, so that the work does not grow with the hold
        while time[-1] - time[0] >= LONGEST + _UPDATE:
            cut = int(np.searchsorted(time, time[0] + LONGEST))
            torque, length = self._windows(hold, time[:cut], readings[:cut])
            hold.torque += torque
            hold.length += length
            time, readings = time[cut:], readings[cut:]
        hold.times, hold.readings = [time], [readings]
        torque, length = self._windows(hold, time, readings)
        whole = hold.length + length
        return (hold.torque + torque) / whole if whole > 0.0 else np.full(3, math.nan)

    def _windows(self, hold: _Hold, time: Array, readings: Array) -> tuple[Array, float]:
        """Return the simulated torques of some samples times the length of their windows, and that length."""
        # the reduction cuts off the settling itself, so it gets the original start of the hold
        setpoint = np.array([hold.setpoint] * 2, dtype=SETPOINT_DTYPE)
        samples = Samples(time, Readings(readings), np.array([time[0] - SETTLING, time[-1]]), setpoint)
        windows = reduce(samples, self._bench)
        if not len(windows):
            return np.zeros(3), 0.0
        coil, motor = Balance(windows, self._bench, clean=False).required(self._bench.values(), self._effects)
        lengths = windows.duration
        return np.array([coil.real @ lengths, coil.imag @ lengths, motor @ lengths]), float(lengths.sum())

    def _estimate(self, hold: _Hold, *, settled: bool) -> list[Estimate]:
        if not hold.count or hold.last - hold.first < _NOTCH_SETTLING:
            return []
        simulated = self._simulated(hold)
        mean, count = hold.filtered / hold.count, hold.count
        # white noise of the readings, and their slow drift, which averaging does not remove
        v = self._bench.value
        std = np.array(
            [
                math.hypot(v("coil_voltage_noise") / math.sqrt(count), v("coil_voltage_drift")),
                math.hypot(v("coil_voltage_noise") / math.sqrt(count), v("coil_voltage_drift")),
                math.hypot(v("motor_voltage_noise") / math.sqrt(count), v("motor_voltage_drift")),
            ]
        )
        dc, tilt = mean[_DC], mean[_TILT]
        if settled and self._reference is None:
            self._reference = dc.copy()
        increment = dc - self._reference if self._reference is not None else np.full(3, math.nan)
        measured, measured_std = self._measured(dc, float(mean[_CURRENT]), std)
        return [
            Estimate(
                stamp_ns=round(hold.last * 1e9),
                segment=int(hold.setpoint.segment),
                settled=settled,
                duration=hold.last - hold.first,
                tilt_x=float(tilt[0]),
                tilt_y=float(tilt[1]),
                spin_rate=hold.spin / count,
                dc_voltage=dc,
                dc_voltage_std=std,
                voltage_increment=increment,
                measured_torque=measured,
                measured_torque_std=measured_std,
                simulated_torque=simulated,
                residual=measured - simulated,
            )
        ]

    def _measured(self, dc: Array, current: float, std: Array) -> tuple[Array, Array]:
        """Return the measured torques and their standard errors; NaN where a constant is not calibrated."""
        torque, error = np.full(3, math.nan), np.full(3, math.nan)
        overrides, v = self._model.overrides, self._bench.value
        if "coil_constant" in overrides:
            torque[:2] = v("coil_constant") * dc[:2]
            error[:2] = np.hypot(
                v("coil_constant") * std[:2], overrides["coil_constant"].standard_error * dc[:2]
            )
        if "motor_constant" in overrides:
            torque[2] = v("motor_constant") * current
            drift = v("motor_constant") * v("motor_current_drift")
            error[2] = math.hypot(drift, overrides["motor_constant"].standard_error * current)
        return torque, error
