"""The drag estimate of the published ground test, hold by hold: notched DC voltages beside simulated torques."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from gyrowheel_analysis.balance import ActiveEffect, Balance
from gyrowheel_analysis.model import Model
from gyrowheel_analysis.reduction import NEEDED, SETTLING, SPIN_SETTLING, Samples, reduce
from gyrowheel_control.plans import HOLD, SETPOINT_DTYPE
from gyrowheel_sim.units import DEG

Array = NDArray[np.float64]

#: Columns of the readings that are filtered: tilts, coil voltages, motor voltage and current.
_COLUMNS = np.array([0, 1, 4, 5, 6, 7])
_RADIUS = 0.97  # of the notch's poles: 10 Hz wide, settles in 0.1 s
_NOTCH_SETTLING = 0.15  # s
_UPDATE = 0.5  # s between two estimates of one hold


@dataclass(frozen=True)
class Estimate:
    """One drag estimate; the fields of the DragEstimate message [SI].

    The torques are those that coils (x, y) and motor give, in case axes. `measured_torque` and `residual` are NaN
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


class DragEstimator:
    """Turns samples and setpoints into drag estimates as they come.

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
        self._raw: list[Array] = []
        self._filtered: list[Array] = []
        self._times: list[Any] = []
        self._setpoints: list[tuple[Any, ...]] = []
        self._hold: tuple[Any, ...] | None = None
        self._start = math.inf
        self._next = math.inf
        self._spin_before: float | None = None
        self._reference: Array | None = None

    def setpoint(self, stamp_ns: int, segment: int, phase: int, values: Sequence[float]) -> None:
        """Take a setpoint: tilt_x, tilt_y, their rates, spin rate and acceleration; stamps must ascend."""
        self._setpoints.append((stamp_ns, segment, phase, *values))

    def add_block(self, stamps_ns: NDArray[np.int64], values: Array) -> list[Estimate]:
        """Take consecutive samples and return the estimates that they complete.

        Parameters
        ----------
        stamps_ns : ndarray (m,)
            Sampling instants [ns].
        values : ndarray (m, 11)
            Readings, columns as in the Measurement message. A sample that lacks one it needs (NaN) counts as lost.
        """
        whole = np.isfinite(values[:, : len(NEEDED)]).all(axis=1)
        if not whole.all():  # the filters would never forget it
            stamps_ns, values = stamps_ns[whole], values[whole]
        filtered = np.empty((len(values), len(_COLUMNS)))
        notch(values, _COLUMNS, values[:, 3], self._bench.sample_period, _RADIUS, self._state, filtered)
        estimates: list[Estimate] = []
        at = 0
        while at < len(stamps_ns):
            # setpoints that begin within the block cut it
            stop = len(stamps_ns)
            if self._setpoints and self._setpoints[0][0] <= stamps_ns[at]:
                estimates += self._take(self._setpoints.pop(0))
                continue
            if self._setpoints:
                stop = min(stop, int(np.searchsorted(stamps_ns, self._setpoints[0][0])))
            if self._hold is not None:
                time = stamps_ns[at:stop] * 1e-9
                keep = time >= self._start
                if keep.any():
                    self._times.append(time[keep])
                    self._raw.append(values[at:stop][keep].copy())
                    self._filtered.append(filtered[at:stop][keep])
                    if time[-1] >= self._next:
                        self._next = float(time[-1]) + _UPDATE
                        estimates += self._estimate(settled=False)
            at = stop
        return estimates

    def finish(self) -> list[Estimate]:
        """Return the estimate of the hold under way, at the end of a test."""
        return self._end()

    def _take(self, setpoint: tuple[Any, ...]) -> list[Estimate]:
        stamp, segment, phase = setpoint[:3]
        spin = float(setpoint[7])
        if self._hold is not None and phase == HOLD and segment == self._hold[1]:
            return []
        estimates = self._end()
        if phase == HOLD and math.hypot(setpoint[5], setpoint[6]) < 0.1 * DEG and abs(setpoint[8]) < 0.5:
            changed = self._spin_before is not None and abs(spin - self._spin_before) > 2.0
            self._hold = setpoint
            self._start = stamp * 1e-9 + (SPIN_SETTLING if changed else SETTLING)
            self._next = self._start + _UPDATE
        if phase == HOLD:
            self._spin_before = spin
        return estimates

    def _end(self) -> list[Estimate]:
        estimates = self._estimate(settled=True) if self._hold is not None else []
        self._hold, self._raw, self._filtered, self._times = None, [], [], []
        return estimates

    def _estimate(self, *, settled: bool) -> list[Estimate]:
        if not self._times or self._hold is None:
            return []
        time, raw, filtered = np.concatenate(self._times), np.vstack(self._raw), np.vstack(self._filtered)
        if time[-1] - time[0] < _NOTCH_SETTLING:
            return []
        bench, values = self._bench, self._bench.values()
        setpoint = np.array([self._hold], dtype=SETPOINT_DTYPE)
        # the reduction drops the settling itself: give it the beginning of the hold as it was
        hold = Samples(
            time, raw, np.array([time[0] - SETTLING, time[-1]]), np.concatenate([setpoint, setpoint])
        )
        windows = reduce(hold, bench)
        simulated = np.full(3, math.nan)
        if len(windows):
            coil, motor = Balance(windows, bench, clean=False).required(values, self._effects)
            weight = windows.duration / windows.duration.sum()
            simulated = np.array([coil.real @ weight, coil.imag @ weight, motor @ weight])
        mean = filtered.mean(axis=0)
        # white noise of the readings and their slow drift, which averaging over a hold does not remove
        count = len(time)
        v = bench.value
        std = np.array(
            [
                math.hypot(v("coil_voltage_noise") / math.sqrt(count), v("coil_voltage_drift")),
                math.hypot(v("coil_voltage_noise") / math.sqrt(count), v("coil_voltage_drift")),
                math.hypot(v("motor_voltage_noise") / math.sqrt(count), v("motor_voltage_drift")),
            ]
        )
        dc = mean[2:5]
        if settled and self._reference is None:
            self._reference = dc.copy()
        increment = dc - self._reference if self._reference is not None else np.full(3, math.nan)
        measured, measured_std = self._measured(dc, float(mean[5]), std)
        return [
            Estimate(
                stamp_ns=round(float(time[-1]) * 1e9),
                segment=int(self._hold[1]),
                settled=settled,
                duration=float(time[-1] - time[0]),
                tilt_x=float(mean[0]),
                tilt_y=float(mean[1]),
                spin_rate=float(raw[:, 3].mean()),
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
        """Return the torques that the readings mean, where the constants are calibrated."""
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
