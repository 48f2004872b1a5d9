"""From 2 kHz samples to windows of whole revolutions: smooth motion, harmonics of the spin, mean voltages.

A window is described so that the torque which its motion needs can be computed exactly: the tilt as a polynomial in
time plus its first and second harmonics of the spin angle, whose amplitudes may vary in the window (on a cone they
turn with the tilt), the smooth spin rate, and the harmonics of the motor's current. Voltages and currents are plain
means, which leaves their noise simple.
"""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gyrowheel_control.plans import HOLD, Plan
from gyrowheel_sim.bench import Bench
from gyrowheel_sim.environment import Environment
from gyrowheel_sim.units import DEG

Array = NDArray[np.float64]

#: Time given to the loops to settle at the start of a steady motion [s]; the spin loop is the slower one.
SETTLING = 0.5
SPIN_SETTLING = 1.0
_SPEED_CHANGE = 2.0  # rad/s; a change of speed beyond this gets SPIN_SETTLING
_LONGEST = 2.0  # s; longer holds are split, so that drift within a window stays small
_SHORTEST = 0.16  # s
_MIN_REVOLUTIONS = 3
_ARC = 35.0 * DEG  # of a cone within one window
_DEGREE = 5  # of the polynomials in time
_SHORT = (
    0.5  # s; in windows shorter than this the spin angle is a cubic, which knows the acceleration far better
)
_MODULATION = 3  # terms of the polynomial in time of a harmonic's amplitude
HARMONICS = (-2, -1, 1, 2)
#: Those of the coils' voltages that are compared: an effect that turns with the rotor acts forward.
FORWARD = (1, 2)
#: Bench parameters on which the reckoned temperatures of the motor depend.
MOTOR_THERMAL = (
    "winding_heat_capacity",
    "winding_thermal_resistance",
    "motor_heat_capacity",
    "motor_thermal_resistance",
)
_THERMAL_STEP = 0.1  # s
_CLEAR = 10.0  # times its noise that a harmonic must be to count


@dataclass(frozen=True)
class Windows:
    """Reduced windows, arrays over the windows (n).

    Attributes
    ----------
    start, duration : ndarray (n,)
        Start [s from the start of the recording] and length [s] of the interval whose voltages are averaged.
    samples : ndarray (n,)
        Samples used.
    segment : ndarray (n,)
        Segment of the plan, -1 where unknown.
    tilt : complex ndarray (n, 6)
        Polynomial of the tilt angles phi_x + i phi_y [rad] in x, the time from the middle over half the duration.
    tilt_harmonics : complex ndarray (n, 4, 3)
        Amplitudes of exp(i h theta_z) in the tilt, h in `HARMONICS`, as polynomials in x [rad].
    spin : ndarray (n, 5)
        Polynomial of the spin rate [rad/s] in x.
    current_harmonics : complex ndarray (n, 4, 3)
        Amplitudes of exp(i h theta_z) in the motor current, h in `HARMONICS`, as polynomials in x [A].
    coil_voltage : complex ndarray (n,)
        Mean coil voltages x + i y [V].
    motor_voltage, motor_current : ndarray (n,)
        Means [V], [A].
    coil_temperature, air_temperature, air_pressure : ndarray (n,)
        Means [K], [K], [Pa].
    coil_temperature_rate : ndarray (n,)
        Slope of the coil temperature [K/s].
    motor_temperatures : ndarray (n, 2)
        Temperatures of the motor's winding and magnets, reckoned from the recorded current [K].
    motor_temperature_rates : ndarray (n, 2)
        Their slopes [K/s].
    temperature_sensitivity : ndarray (n, 2, 4)
        Their derivatives by the parameters of `MOTOR_THERMAL`.
    coil_harmonics : complex ndarray (n, 2)
        Amplitudes of exp(i h theta_z) in the coil voltages x + i y as they act between two samples, h in `FORWARD` [V].
    spin_ripple, current_ripple, voltage_ripple : complex ndarray (n,)
        Amplitude of exp(i p theta_z) in spin rate [rad/s], motor current [A] and motor voltage [V]; p is the order of
        the motor's ripple.
    up : ndarray (n,)
        Component along case z of the unit vector that points up: +1 upright, -1 inverted.
    up_across, home_x, home_y : complex ndarray (n,)
        Components across case z of that vector, and of the horizontal home axes.
    table_rate : ndarray (n,)
        Rate of the table about the vertical, as commanded [rad/s].
    tilt_rate_variance : ndarray (n,)
        Variance of the mean tilt rate, one axis, from white noise of the tilt readings [rad^2/s^2].
    spin_acceleration_variance : ndarray (n,)
        Variance of the mean spin acceleration from white noise of the angle readings [rad^2/s^4].
    """

    start: Array
    duration: Array
    samples: Array
    segment: NDArray[np.int64]
    tilt: NDArray[np.complex128]
    tilt_harmonics: NDArray[np.complex128]
    spin: Array
    current_harmonics: NDArray[np.complex128]
    coil_voltage: NDArray[np.complex128]
    motor_voltage: Array
    motor_current: Array
    coil_temperature: Array
    coil_temperature_rate: Array
    air_temperature: Array
    air_pressure: Array
    motor_temperatures: Array
    motor_temperature_rates: Array
    temperature_sensitivity: Array
    coil_harmonics: NDArray[np.complex128]
    spin_ripple: NDArray[np.complex128]
    current_ripple: NDArray[np.complex128]
    voltage_ripple: NDArray[np.complex128]
    up: Array
    up_across: NDArray[np.complex128]
    home_x: NDArray[np.complex128]
    home_y: NDArray[np.complex128]
    table_rate: Array
    tilt_rate_variance: Array
    spin_acceleration_variance: Array

    def __len__(self) -> int:
        """Return the number of windows."""
        return len(self.start)

    def select(self, rows: Any) -> Windows:
        """Return some of the windows (index or mask)."""
        return Windows(*(getattr(self, item.name)[rows] for item in fields(self)))

    @property
    def middle(self) -> Array:
        """Middle of each window [s]."""
        return self.start + 0.5 * self.duration

    @property
    def mean_tilt(self) -> NDArray[np.complex128]:
        """Mean tilt angles phi_x + i phi_y [rad]."""
        return self.tilt @ _MEAN[: self.tilt.shape[1]]

    @property
    def mean_tilt_rate(self) -> NDArray[np.complex128]:
        """Mean tilt rate [rad/s]."""
        return self.tilt @ _RISE[: self.tilt.shape[1]] / self.duration

    @property
    def mean_spin(self) -> Array:
        """Mean spin rate [rad/s]."""
        return self.spin @ _MEAN[: self.spin.shape[1]]

    @property
    def mean_spin_acceleration(self) -> Array:
        """Mean spin acceleration [rad/s^2]."""
        return self.spin @ _RISE[: self.spin.shape[1]] / self.duration

    @property
    def moving(self) -> NDArray[np.bool_]:
        """Whether the tilt moves (a cone) or the speed does (a sweep), beyond the settling of a hold."""
        return (np.abs(self.mean_tilt_rate) > 0.5 * DEG) | (np.abs(self.mean_spin_acceleration) > 1.0)


#: Mean over -1..1, and difference between the ends, of the powers of x.
_MEAN = np.array([1.0 / (k + 1) if k % 2 == 0 else 0.0 for k in range(_DEGREE + 1)])
_RISE = np.array([2.0 if k % 2 else 0.0 for k in range(_DEGREE + 1)])


def without_noise(windows: Windows, bench: Bench) -> Windows:
    """Return the windows without those harmonics that are not well above the noise of the readings.

    Where a harmonic is noise, so is every torque reckoned from it, and whatever multiplies such a torque (a gain, a
    scale, a damping) would be fitted to the noise.
    """
    v, n = bench.value, windows.samples
    modulation = np.array([[_MEAN[j + k] for k in range(_MODULATION)] for j in range(_MODULATION)])

    def kept(amplitudes: Any, noise: float) -> Any:
        """Amplitudes (n, harmonics, terms) that are above the noise of a reading, both parts together."""
        power = np.einsum("nhj,jk,nhk->nh", amplitudes.conj(), modulation, amplitudes).real
        return np.where((power > _CLEAR**2 * 2.0 * noise**2 / n[:, None])[:, :, None], amplitudes, 0.0)

    def above(amplitude: Any, noise: float) -> Any:
        return np.where(np.abs(amplitude) > _CLEAR * noise / np.sqrt(n), amplitude, 0.0)

    return replace(
        windows,
        tilt_harmonics=kept(windows.tilt_harmonics, v("tilt_noise")),
        # of a real reading both signs of a harmonic share the noise
        current_harmonics=kept(windows.current_harmonics, math.sqrt(0.5) * v("motor_current_noise")),
        spin_ripple=above(windows.spin_ripple, v("spin_rate_noise")),
        current_ripple=above(windows.current_ripple, v("motor_current_noise")),
        voltage_ripple=above(windows.voltage_ripple, v("motor_voltage_noise")),
    )


def concatenate(parts: Sequence[Windows]) -> Windows:
    """Join windows of several recordings (times stay those of each recording)."""
    return Windows(*(np.concatenate([getattr(p, item.name) for p in parts]) for item in fields(Windows)))


@dataclass(frozen=True)
class Samples:
    """The columns of a recording that the reduction needs.

    Attributes
    ----------
    time : ndarray (n,)
        Sampling instants [s].
    values : ndarray (n, 11)
        Readings, columns as in the Measurement message [SI].
    setpoint_time : ndarray (m,)
        Times of the setpoints [s]; empty if there are none.
    setpoint : structured ndarray (m,)
        Setpoints with fields ``segment``, ``phase``, ``tilt_rate_x``, ``tilt_rate_y``, ``spin_acceleration``.
    environment : sequence of Environment
        Known changes of the environment.
    """

    time: Array
    values: Array
    setpoint_time: Array
    setpoint: Any
    environment: Sequence[Environment] = ()


def steady_spans(data: Samples) -> list[tuple[float, float, int, float]]:
    """Return the steady motions as (start, stop [s], segment, rate of the tilt's direction [rad/s]).

    They are taken from the setpoints where there are any, else found in the motion itself.
    """
    if len(data.setpoint_time):
        return _spans_from_setpoints(data)
    return _spans_from_motion(data)


def _spans_from_setpoints(data: Samples) -> list[tuple[float, float, int, float]]:
    sp, time = data.setpoint, data.setpoint_time
    step = float(np.median(np.diff(time))) if len(time) > 1 else 0.005
    key = sp["segment"].astype(np.int64) * 2 + (sp["phase"] == HOLD)
    edges = np.flatnonzero(np.diff(key)) + 1
    spans = []
    for a, b in zip(np.r_[0, edges], np.r_[edges, len(key)], strict=True):
        if sp["phase"][a] != HOLD:
            continue
        changed = (
            a > 0 and abs(sp["spin_rate"][a] - sp["spin_rate"][max(a - round(0.5 / step), 0)]) > _SPEED_CHANGE
        )
        settling = SPIN_SETTLING if changed else SETTLING
        speed = math.hypot(sp["tilt_rate_x"][a], sp["tilt_rate_y"][a])
        radius = math.hypot(sp["tilt_x"][a], sp["tilt_y"][a])
        turn = speed / radius if radius > 0.0 else 0.0
        spans.append((float(time[a]) + settling, float(time[b - 1]) + step, int(sp["segment"][a]), turn))
    return spans


def _spans_from_motion(data: Samples) -> list[tuple[float, float, int, float]]:
    """Find steady motion by itself: the tilt rate and the spin acceleration change little over 0.25 s."""
    h = float(np.median(np.diff(data.time)))
    block = max(round(0.05 / h), 1)
    n = len(data.time) // block
    if n < 10:
        return []
    time = data.time[: n * block].reshape(n, block).mean(axis=1)
    means = data.values[: n * block].reshape(n, block, -1).mean(axis=1)
    tilt, spin = means[:, 0] + 1j * means[:, 1], means[:, 3]
    rate = np.gradient(tilt, time)
    bend = np.abs(np.gradient(rate, time))
    jerk = np.abs(np.gradient(np.gradient(spin, time), time))
    # a cone of 4 deg in 2.5 s bends by 25 deg/s^2; the corners of a ramp by several hundred
    calm = (bend < 0.6 * np.maximum(np.abs(rate) * 4.0, 0.05)) & (jerk < 15.0)
    calm = np.convolve(calm, np.ones(5), mode="same") >= 5
    edges = np.flatnonzero(np.diff(np.r_[0, calm.astype(int), 0]))
    spans = []
    for a, b in zip(edges[::2], edges[1::2], strict=True):
        speed, radius = float(np.median(np.abs(rate[a:b]))), float(np.median(np.abs(tilt[a:b])))
        turn = speed / radius if speed > 0.5 * DEG and radius > 0.2 * DEG else 0.0
        spans.append((float(time[a]) + 0.5 * SETTLING, float(time[b - 1]), -1, turn))
    return spans


def reduce(data: Samples, bench: Bench) -> Windows:
    """Reduce a recording to windows of whole revolutions.

    Parameters
    ----------
    data : Samples
        The recording's columns.
    bench : Bench
        Gives the noise of the readings.

    Returns
    -------
    Windows
        In time order; empty if the recording has no steady motion.
    """
    h = bench.sample_period
    rows: list[dict[str, Any]] = []
    heat = motor_temperatures(data, bench)
    for start, stop, segment, turn in steady_spans(data):
        longest = _LONGEST
        if turn > 0.0:
            inside = (data.time >= start) & (data.time < stop)
            speed = float(np.median(data.values[inside, 3])) if inside.any() else math.nan
            if not speed > 0.0:
                continue
            # short enough that the cone bends little, long enough for whole revolutions
            longest = min(
                _LONGEST, max(_ARC / turn, _SHORTEST, (_MIN_REVOLUTIONS + 1) * 2.0 * math.pi / speed)
            )
        count = (
            max(math.floor((stop - start) / longest), 1)
            if turn
            else max(math.ceil((stop - start) / longest - 1e-6), 1)
        )
        edges = np.linspace(start, stop, count + 1)
        for a, b in itertools.pairwise(edges):
            i, j = np.searchsorted(data.time, (a - 1e-9, b - 1e-9))
            row = _window(data, int(i), int(j), h, bench, heat)
            if row is not None:
                row["segment"] = segment
                rows.append(row)
    names = [item.name for item in fields(Windows)]
    columns = {name: np.array([row[name] for row in rows]) for name in names}
    if not rows:
        harmonics = (0, len(HARMONICS), _MODULATION)
        shapes: dict[str, Any] = {
            "tilt": (0, _DEGREE + 1),
            "tilt_harmonics": harmonics,
            "spin": (0, _DEGREE),
            "current_harmonics": harmonics,
            "coil_harmonics": (0, len(FORWARD)),
            "motor_temperatures": (0, 2),
            "motor_temperature_rates": (0, 2),
            "temperature_sensitivity": (0, 2, len(MOTOR_THERMAL)),
        }
        columns = {name: np.zeros(shapes.get(name, 0)) for name in names}
    return Windows(**columns)


def motor_temperatures(data: Samples, bench: Bench) -> tuple[Array, Array, Array]:
    """Reckon the temperatures of the motor's winding and magnets from the recorded current.

    Parameters
    ----------
    data : Samples
        The recording; the motor is taken to have the temperature of the air at its start.
    bench : Bench
        Gives the heat capacities and thermal resistances (`MOTOR_THERMAL`).

    Returns
    -------
    time : ndarray (m,)
        Instants [s].
    temperature : ndarray (m, 2)
        Winding and magnets [K].
    sensitivity : ndarray (m, 2, 4)
        Derivatives by the parameters of `MOTOR_THERMAL`.
    """
    stated = np.array([bench.value(name) for name in MOTOR_THERMAL])
    if len(data.time) == 0:
        return np.zeros(1), np.full((1, 2), bench.value("air_temperature")), np.zeros((1, 2, len(stated)))
    block = ((data.time - data.time[0]) / _THERMAL_STEP).astype(np.int64)
    count = int(block[-1]) + 1
    # blocks without any sample keep the heating of the one before
    samples = np.bincount(block, minlength=count)
    sums = np.bincount(block, weights=data.values[:, 7] ** 2, minlength=count)
    known = np.flatnonzero(samples)
    last = known[np.searchsorted(known, np.arange(count), side="right") - 1]
    power = bench.value("motor_resistance") * (sums[last] / samples[last])
    above = _warming(power, stated)
    sensitivity = np.empty((*above.shape, len(stated)))
    for k, value in enumerate(stated):
        moved = stated.copy()
        moved[k] *= 1.01
        sensitivity[..., k] = (_warming(power, moved) - above) / (0.01 * value)
    air = float(np.mean(data.values[:, 9]))
    return data.time[0] + _THERMAL_STEP * np.arange(count + 1), air + above, sensitivity


def _warming(power: Array, parameters: Array) -> Array:
    """Return how far winding and magnets are above the air, (m + 1, 2) [K], for the heating in each step (m,) [W]."""
    winding, resistance, magnets, outer = parameters
    inward, outward = 1.0 / resistance, 1.0 / outer
    rates = np.array(
        [[-inward / winding, inward / winding], [inward / magnets, -(inward + outward) / magnets]]
    )
    values, modes = np.linalg.eig(rates)
    drive = np.linalg.solve(modes, np.array([1.0 / winding, 0.0]))
    result = np.zeros((len(power) + 1, 2))
    for value, mode, gain in zip(values, modes.T, drive, strict=True):
        step = math.exp(value * _THERMAL_STEP)
        heating = (gain * (step - 1.0) / value * power).tolist()
        own = list(itertools.accumulate(heating, functools.partial(_fading, step), initial=0.0))
        result += np.array(own)[:, None] * mode[None, :]
    return result


def _fading(step: float, before: float, more: float) -> float:
    return step * before + more


def _window(
    data: Samples, i: int, j: int, h: float, bench: Bench, heat: tuple[Array, Array, Array]
) -> dict[str, Any] | None:
    """Reduce samples i .. j-1, shortened to whole revolutions; None if there is too little of them."""
    if j - i < 3 * _MIN_REVOLUTIONS:
        return None
    angle = np.unwrap(data.values[i:j, 2])
    turns = math.floor((angle[-1] - angle[0]) / (2.0 * math.pi))
    if turns < _MIN_REVOLUTIONS:
        return None
    # the last sample belongs to the interval before it, so n samples cover n periods
    stop = int(np.searchsorted(angle, angle[0] + 2.0 * math.pi * turns - 0.5 * (angle[1] - angle[0])))
    j, angle = i + stop, angle[:stop]
    time, values = data.time[i:j], data.values[i:j]
    if len(time) < 0.7 * (time[-1] - time[0]) / h or time[-1] - time[0] < 0.5 * _SHORTEST:
        return None  # too many samples lost
    begin, end = (
        float(time[0]) - h,
        float(time[-1]),
    )  # a reading of a voltage is of the interval that ends with it
    duration = end - begin
    x = (time - 0.5 * (begin + end)) / (0.5 * duration)
    powers = x[:, None] ** np.arange(_DEGREE + 1)
    waves = (np.exp(1j * np.outer(angle, HARMONICS))[:, :, None] * powers[:, None, :_MODULATION]).reshape(
        len(x), -1
    )
    design = np.hstack([powers, waves])
    degree = _DEGREE + 1
    # the smooth part of the speed comes from the angle, which knows its slope far better
    readings = np.column_stack(
        [
            values[:, 0] + 1j * values[:, 1],
            values[:, 7],
            values[:, 4] + 1j * values[:, 5],
            values[:, 3],
            values[:, 6],
        ]
    )
    gram = np.linalg.inv(design.conj().T @ design)
    fit = (gram @ (design.conj().T @ readings)).T
    smooth = degree if duration > _SHORT else 4
    ripple = _ripple(readings[:, (3, 1, 4)].real - (design @ fit[[3, 1, 4]].T).real, angle, bench)
    turning = np.hstack([powers[:, :smooth], waves])
    turning_gram = np.linalg.inv(turning.conj().T @ turning)
    turning_fit = np.zeros(degree)
    turning_fit[:smooth] = (turning_gram @ (turning.conj().T @ angle))[:smooth].real
    modulation = (len(HARMONICS), _MODULATION)
    inverse = gram[:degree, :degree].real
    rise = _RISE / duration
    # mean of the second derivative of the angle: difference of its slope between the ends
    slope = (
        np.array([0.0 if k < 2 else k * (1.0 - (-1.0) ** (k - 1)) for k in range(smooth)]) * 2.0 / duration**2
    )
    warm = np.polynomial.polynomial.polyfit(x, values[:, 8], 1)
    last = [e for e in data.environment if e.time <= begin + 1e-6]
    surroundings = last[-1] if last else Environment()
    means = values.mean(axis=0)
    coils = fit[2, degree:].reshape(modulation)[[HARMONICS.index(order) for order in FORWARD]]
    held = _held(np.array(FORWARD), float(means[3]) * h)
    return {
        "start": begin,
        "duration": duration,
        "samples": float(len(time)),
        "tilt": fit[0, :degree],
        "tilt_harmonics": fit[0, degree:].reshape(modulation),
        "spin": turning_fit[1:] * np.arange(1, degree) * 2.0 / duration,
        "current_harmonics": fit[1, degree:].reshape(modulation),
        "coil_voltage": complex(means[4], means[5]),
        "motor_voltage": means[6],
        "motor_current": means[7],
        "coil_temperature": means[8],
        "coil_temperature_rate": warm[1] * 2.0 / duration,
        "air_temperature": means[9],
        "air_pressure": means[10],
        "motor_temperatures": _at(heat[0], heat[1], 0.5 * (begin + end)),
        "motor_temperature_rates": (_at(heat[0], heat[1], end) - _at(heat[0], heat[1], begin)) / duration,
        "temperature_sensitivity": _at(heat[0], heat[2], 0.5 * (begin + end)),
        "coil_harmonics": coils @ _MEAN[:_MODULATION] * held,
        "spin_ripple": ripple[0],
        "current_ripple": ripple[1],
        "voltage_ripple": ripple[2] * _held(bench.value("motor_ripple_order"), float(means[3]) * h),
        **_attitude(surroundings),
        "tilt_rate_variance": float(rise @ inverse @ rise) * bench.value("tilt_noise") ** 2,
        "spin_acceleration_variance": float(slope @ turning_gram[:smooth, :smooth].real @ slope)
        * bench.value("spin_angle_noise") ** 2,
    }


def _at(time: Array, values: Array, when: float) -> Array:
    """Interpolate rows of `values`."""
    place = float(np.clip((when - time[0]) / _THERMAL_STEP, 0.0, len(time) - 1.0))
    low = min(int(place), max(len(time) - 2, 0))
    high = min(low + 1, len(time) - 1)
    return np.asarray(values[low] + (place - low) * (values[high] - values[low]))


def _held(order: Any, turn: float) -> Any:
    """Return the factor from the amplitude of a sampled voltage to that of the voltage as it is held.

    A sample is read at the end of the interval in which it acted; `turn` is the angle turned in an interval [rad].
    """
    half = 0.5 * order * turn
    return np.exp(1j * half) * np.sinc(half / math.pi)


def _ripple(left: Array, angle: Array, bench: Bench) -> NDArray[np.complex128]:
    """Return the amplitudes of the motor's ripple in what the smooth part and the harmonics leave, by column."""
    wave = np.exp(-1j * bench.value("motor_ripple_order") * angle)
    return np.asarray(wave @ left / len(angle), dtype=np.complex128)


def _attitude(environment: Environment) -> dict[str, Any]:
    """Return the columns that say how the rig stands."""
    first, second = environment.home
    return {
        "up": environment.up,
        "up_across": environment.up_across,
        "home_x": first,
        "home_y": second,
        "table_rate": environment.table_rate,
    }


def planned_windows(plan: Plan, bench: Bench) -> Windows:
    """Return the windows that a plan would give if the loops followed it exactly: for judging it before it is run.

    Parameters
    ----------
    plan : Plan
        The plan.
    bench : Bench
        Gives the noise, the air and the times of the heater.
    """
    h, noise = bench.sample_period, bench.value
    powers = np.arange(_DEGREE + 1)
    rows: list[dict[str, Any]] = []
    warm = 0.0
    for s in plan.segments:
        # the coils follow the heater within a second and cool with their own time constant
        cooling = noise("coil_thermal_resistance") * noise("coil_heat_capacity")
        warm = s.environment.preheat or warm * math.exp(-(s.ramp + s.hold) / cooling)
        settling = SPIN_SETTLING if abs(s.spin - s.spin_from) > _SPEED_CHANGE else SETTLING
        length = s.hold - settling
        longest = _LONGEST if s.cone_rate == 0.0 else max(_ARC / abs(s.cone_rate), _SHORTEST)
        count = max(math.floor(length / longest) if s.cone_rate else math.ceil(length / longest - 1e-6), 1)
        duration = length / count
        if duration < _SHORTEST or duration * s.spin < _MIN_REVOLUTIONS * 2.0 * math.pi:
            continue
        slope = (s.spin_end - s.spin) / s.hold
        for k in range(count):
            middle = settling + (k + 0.5) * duration
            turn = 1j * s.cone_rate * 0.5 * duration
            series = np.array([turn**n / math.factorial(n) for n in powers])
            spin = np.zeros(_DEGREE)
            spin[:2] = s.spin + slope * middle, slope * 0.5 * duration
            samples = duration / h
            rows.append(
                {
                    "start": s.start + s.ramp + middle - 0.5 * duration,
                    "duration": duration,
                    "samples": samples,
                    "segment": -1,
                    "tilt": s.tilt * np.exp(1j * s.cone_rate * middle) * series,
                    "tilt_harmonics": np.zeros((len(HARMONICS), _MODULATION), dtype=complex),
                    "spin": spin,
                    "current_harmonics": np.zeros((len(HARMONICS), _MODULATION), dtype=complex),
                    "coil_voltage": 0.0j,
                    "motor_voltage": 0.0,
                    "motor_current": 0.0,
                    "coil_temperature": noise("air_temperature") + warm,
                    "coil_temperature_rate": 0.0,
                    "air_temperature": noise("air_temperature"),
                    "air_pressure": noise("air_pressure") * s.environment.air_density_ratio,
                    "motor_temperatures": np.full(2, noise("air_temperature")),
                    "motor_temperature_rates": np.zeros(2),
                    "temperature_sensitivity": np.zeros((2, len(MOTOR_THERMAL))),
                    "coil_harmonics": np.zeros(len(FORWARD), dtype=complex),
                    "spin_ripple": 0.0j,
                    "current_ripple": 0.0j,
                    "voltage_ripple": 0.0j,
                    **_attitude(s.environment),
                    # the ends of a polynomial of this degree: see `_window`
                    "tilt_rate_variance": 2.0
                    * (_DEGREE + 1) ** 2
                    / samples
                    * (noise("tilt_noise") / duration) ** 2,
                    "spin_acceleration_variance": 2.0
                    * (_DEGREE + 1) ** 5
                    / samples
                    * (noise("spin_angle_noise") / duration**2) ** 2,
                }
            )
    return Windows(**{item.name: np.array([row[item.name] for row in rows]) for item in fields(Windows)})
