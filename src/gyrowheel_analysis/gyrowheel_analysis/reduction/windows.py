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
from scipy.signal.windows import blackmanharris

from gyrowheel_control.plans import HOLD, Plan
from gyrowheel_sim.bench import Bench
from gyrowheel_sim.environment import Environment
from gyrowheel_sim.units import DEG

Array = NDArray[np.float64]

#: Time given to the loops to settle at the start of a steady motion [s]; the spin loop is the slower one.
SETTLING = 0.5
SPIN_SETTLING = 1.0
#: On a cone the windows are too short to follow the spin loop: after a change of speed it gets so much longer [s], and
#: a window in which the speed changes faster than so [rad/s^2], or is farther from the last one, is left out.
_CONE_SETTLING, _CONE_DRIFT, _CONE_OFF = 0.5, 2.0, 0.01
_SPEED_CHANGE = 2.0  # rad/s; a change of speed beyond this gets SPIN_SETTLING
_LONGEST = 2.0  # s; longer holds are split, so that drift within a window stays small
_SHORTEST = 0.16  # s
_MIN_REVOLUTIONS = 3
_LEAST_TURN = 4.1  # revolutions of a part of a cone: four whole ones at least
_ARC = 35.0 * DEG  # of a cone within one window
_DEGREE = 5  # of the polynomials in time
#: Terms of the polynomial of the spin angle in windows shorter than so many seconds: the short ones know the
#: acceleration far better by a cubic, the long ones hold what the spin loop does after every change of the tilt.
_SPIN_TERMS = ((0.5, 4), (1.0, 8), (math.inf, 12))
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
_CLEAR = 10.0  # times its noise that a harmonic, or an acceleration of the spin, must be to count
#: What the noise of the readings is called in the bench file, in the order of `Windows.reading_noise`.
READING_NOISES = (
    "tilt_noise",
    "spin_angle_noise",
    "spin_rate_noise",
    "coil_voltage_noise",
    "motor_voltage_noise",
    "motor_current_noise",
)
_NOISE_BLOCKS = (256, 64)  # samples; the short ones where many samples are lost
_MOST_BLOCKS = 400
_FEWEST_BLOCKS = 20
_NOISE_BAND = (0.4, 0.97)  # of half the sampling rate: above every motion, below what a filter may cut away
_NOISE_RANGE = (0.5, 50.0)  # times the stated noise that is believed
_SPIKE = 8.0  # robust standard deviations
_MOST_SPIKES = 0.02  # of the samples; more of them are no spikes
_SPIKE_ROUNDS = 12
#: Mean square, in its noise, of four more terms of the polynomials: beyond it the motion is not settled.
_UNSETTLED_TILT, _UNSETTLED_ANGLE = 10.0, 20.0
_FURTHER = 4
#: What a window leaves of the motor's current beside harmonics and ripple, in its noise: beyond it something goes on
#: that averages do not describe, as a supply that fails.
_RESTLESS = 30.0
_SETTLES_BY = 0.2  # s; by so much later a window begins if its motion has not settled


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
    harmonic_variance : ndarray (n, 2)
        Variance of these, and of those of the tilt, over that of a mean: more than one where a window has so few
        revolutions that harmonics and slow motion are hard to tell apart.
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
    reading_noise : ndarray (n, 6)
        Standard deviation of the white noise of the readings of `READING_NOISES`, as the recording has it [SI].
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
    harmonic_variance: Array
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
    reading_noise: Array

    def noise(self, name: str) -> Array:
        """Return the white noise of a reading, by its name in the bench file, (n,) [SI]."""
        return np.asarray(self.reading_noise[:, READING_NOISES.index(name)])

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


#: From a Legendre series of `_DEGREE` terms to powers of x.
_TO_POWERS = np.zeros((_DEGREE, _DEGREE))
for _term in range(_DEGREE):
    _TO_POWERS[: _term + 1, _term] = np.polynomial.legendre.leg2poly(np.eye(_DEGREE)[_term])[: _term + 1]


def without_noise(windows: Windows) -> Windows:
    """Return the windows without those harmonics and accelerations that are not well above the noise of the readings.

    Where one of them is noise, so is every torque reckoned from it, and whatever multiplies such a torque (a gain, a
    scale, a damping, a moment of inertia) would be fitted to the noise. An inertia would come out too small by the
    share of the noise in the mean square of the accelerations (errors in variables), and all other scales with it.
    """
    v, n = windows.noise, windows.samples
    modulation = np.array([[_MEAN[j + k] for k in range(_MODULATION)] for j in range(_MODULATION)])

    def kept(amplitudes: Any, noise: Array) -> Any:
        """Amplitudes (n, harmonics, terms) that are above the noise of a reading, both parts together."""
        power = np.einsum("nhj,jk,nhk->nh", amplitudes.conj(), modulation, amplitudes).real
        clear = power > _CLEAR**2 * 2.0 * (noise**2 / n)[:, None]
        return np.where(clear[:, :, None], amplitudes, 0.0)

    def above(amplitude: Any, noise: Array) -> Any:
        return np.where(np.abs(amplitude) > _CLEAR * noise / np.sqrt(n), amplitude, 0.0)

    rise = windows.mean_spin_acceleration * windows.duration
    noisy = rise**2 < (_CLEAR * windows.duration) ** 2 * windows.spin_acceleration_variance
    spin = windows.spin.copy()
    spin[:, 1] -= 0.5 * np.where(noisy, rise, 0.0)
    return replace(
        windows,
        spin=spin,
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
        if changed and turn > 0.0:
            settling += _CONE_SETTLING
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
    noise = reading_noise(data, bench)
    clipped = _clipped(data)
    heat = motor_temperatures(data, bench)
    for start, stop, segment, turn in steady_spans(data):
        longest, last = _LONGEST, 0.0
        if turn > 0.0:
            inside = (data.time >= start) & (data.time < stop)
            speed = float(np.median(data.values[inside, 3])) if inside.any() else math.nan
            if not speed > 0.0:
                continue
            last = float(np.median(data.values[inside, 3][-max(int(inside.sum()) // 10, 1) :]))
            # short enough that the cone bends little, long enough for whole revolutions
            longest = min(_LONGEST, max(_ARC / turn, _SHORTEST, _LEAST_TURN * 2.0 * math.pi / speed))
        count = (
            max(math.floor((stop - start) / longest), 1)
            if turn
            else max(math.ceil((stop - start) / longest - 1e-6), 1)
        )
        edges = np.linspace(start, stop, count + 1)
        for a, b in itertools.pairwise(edges):
            row = None
            while row is None and b - a >= _SHORTEST:
                i, j = (int(k) for k in np.searchsorted(data.time, (a - 1e-9, b - 1e-9)))
                if clipped[i:j].any():
                    break
                row = _window(data, i, j, h, bench, heat, noise)
                if turn and row is not None and not _at_speed(row, last, b - a):
                    row = None
                if turn or row is None or not row.pop("unsettled"):
                    break
                row, a = None, a + _SETTLES_BY
            if row is not None and not row.pop("unsettled", False):
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
            "harmonic_variance": (0, len(FORWARD)),
            "motor_temperatures": (0, 2),
            "motor_temperature_rates": (0, 2),
            "temperature_sensitivity": (0, 2, len(MOTOR_THERMAL)),
            "reading_noise": (0, len(READING_NOISES)),
        }
        columns = {name: np.zeros(shapes.get(name, 0)) for name in names}
    return Windows(**columns)


def _at_speed(row: dict[str, Any], last: float, length: float) -> bool:
    """Whether the rotor has come to the speed of a cone: it neither changes nor is it at a turning point."""
    change, mean = row["spin"] @ _RISE[:_DEGREE], row["spin"] @ _MEAN[:_DEGREE]
    return abs(change) <= _CONE_DRIFT * length and abs(mean - last) <= _CONE_OFF * last


def reading_noise(data: Samples, bench: Bench) -> Array:
    """Return the standard deviation of the white noise of the readings of `READING_NOISES` [SI], (6,).

    It is that of the upper part of the spectrum, where nothing moves; the median there passes over lines, as those of
    the motor's ripple. What the controller makes of its readings reaches up to there in the coils' voltages, so that
    the stated noise is kept for these; so it is where too many samples are lost, or the spectrum is empty.
    """
    stated = np.array([bench.value(name) for name in READING_NOISES])
    columns = [(0, 1), (2,), (3,), (), (6,), (7,)]
    wanted = sorted({c for group in columns for c in group})
    whole = np.flatnonzero(np.abs(np.diff(data.time) - bench.sample_period) > 0.5 * bench.sample_period) + 1
    edges = np.r_[0, whole, len(data.time)]
    for block in _NOISE_BLOCKS:
        starts = np.concatenate(
            [np.arange(a, b - block + 1, block) for a, b in itertools.pairwise(edges)] or [np.zeros(0, int)]
        ).astype(np.int64)
        if len(starts) >= _FEWEST_BLOCKS:
            break
    else:
        return stated
    starts = starts[np.linspace(0, len(starts) - 1, min(len(starts), _MOST_BLOCKS)).astype(np.int64)]
    values = data.values[starts[:, None] + np.arange(block)][:, :, wanted]
    values[:, :, wanted.index(2)] = np.unwrap(values[:, :, wanted.index(2)], axis=1)
    x = np.linspace(-1.0, 1.0, block)
    basis, _ = np.linalg.qr(x[:, None] ** np.arange(3))
    values = values - basis @ (basis.T @ values)
    window = blackmanharris(block, sym=False)
    power = np.abs(np.fft.rfft(values * window[:, None], axis=1)) ** 2 / np.sum(window**2)
    low, high = (round(edge * block / 2) for edge in _NOISE_BAND)
    level = np.median(np.median(power[:, low:high], axis=1), axis=0) / math.log(2.0)
    found = [np.sqrt(np.mean([level[wanted.index(c)] for c in group])) if group else 0.0 for group in columns]
    return np.array(
        [
            own if ratio == 0.0 else own * min(max(ratio, _NOISE_RANGE[0]), _NOISE_RANGE[1])
            for own, ratio in zip(stated, np.array(found) / stated, strict=True)
        ]
    )


def _clipped(data: Samples) -> NDArray[np.bool_]:
    """Return where a reading of tilt, speed or current stands at the end of its range, as a clipped one does."""
    result = np.zeros(len(data.time), dtype=bool)
    if not len(data.time):
        return result
    for column in (0, 1, 3, 7):
        values = data.values[:, column]
        for end in (values.min(), values.max()):
            at = values == end
            # noise reaches its extreme once; a reading without any noise stands anywhere for long
            if at.sum() > 20 and not _quantised(values):
                result |= at
    return result


def _quantised(values: Array) -> bool:
    """Whether a reading takes so few values that it reaches its extreme often without being clipped."""
    some = values[:: max(len(values) // 5000, 1)]
    return len(np.unique(some)) < 0.2 * len(some)


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
    data: Samples,
    i: int,
    j: int,
    h: float,
    bench: Bench,
    heat: tuple[Array, Array, Array],
    noise: Array,
) -> dict[str, Any] | None:
    """Reduce samples i .. j-1, shortened to whole revolutions; None if there is too little of them.

    ``unsettled`` in the result says whether the motion is beyond what the polynomials can follow.
    """
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
    readings, fit = _despiked(readings, design, gram)
    left = readings - design @ fit.T
    smooth = next(terms for length, terms in _SPIN_TERMS if duration <= length)
    ripple = _ripple(left[:, (3, 1, 4)].real, angle, bench)
    legendre = np.polynomial.legendre.legvander(x, smooth - 1)
    turning = np.hstack([legendre, waves])
    turning_gram = np.linalg.inv(turning.conj().T @ turning)
    angles, turns_fit = _despiked(angle[:, None], turning, turning_gram)
    angle, turned = angles[:, 0].real, turns_fit[0]
    tilt_noise, angle_noise, current_noise = (
        noise[READING_NOISES.index(name)]
        for name in ("tilt_noise", "spin_angle_noise", "motor_current_noise")
    )
    unsettled = (
        _more(x, design, gram, left[:, 0], degree) > 2.0 * _UNSETTLED_TILT * tilt_noise**2
        or _more(x, turning, turning_gram, angle - (turning @ turned).real, smooth)
        > _UNSETTLED_ANGLE * angle_noise**2
        or np.mean(np.abs(left[:, 1]) ** 2) - 2.0 * abs(ripple[1]) ** 2 > (_RESTLESS * current_noise) ** 2
    )
    modulation = (len(HARMONICS), _MODULATION)
    inverse = gram[:degree, :degree].real
    rise = _RISE / duration
    # mean of the second derivative of the angle: difference of its slope, n (n + 1) / 2 at the end, between the ends
    slope = np.array([k * (k + 1) * (1 - k % 2) for k in range(smooth)]) * 2.0 / duration**2
    slow = _without_spikes(values[:, 8:11])
    warm = np.polynomial.polynomial.polyfit(x, slow[:, 0], 1)
    last = [e for e in data.environment if e.time <= begin + 1e-6]
    surroundings = last[-1] if last else Environment()
    means = readings.mean(axis=0)
    air = slow.mean(axis=0)
    speed = float(means[3].real)
    forward = [HARMONICS.index(order) for order in FORWARD]
    coils = fit[2, degree:].reshape(modulation)[forward]
    places = [slice(degree + k * _MODULATION, degree + (k + 1) * _MODULATION) for k in forward]
    mean = _MEAN[:_MODULATION]
    held = _held(np.array(FORWARD), speed * h)
    return {
        "unsettled": unsettled,
        "start": begin,
        "duration": duration,
        "samples": float(len(time)),
        "tilt": fit[0, :degree],
        "tilt_harmonics": fit[0, degree:].reshape(modulation),
        "spin": _shortened(np.asarray(np.polynomial.legendre.legder(turned[:smooth].real), dtype=np.float64))
        * 2.0
        / duration,
        "current_harmonics": fit[1, degree:].reshape(modulation),
        "coil_voltage": complex(means[2]),
        "motor_voltage": float(means[4].real),
        "motor_current": float(means[1].real),
        "coil_temperature": air[0],
        "coil_temperature_rate": warm[1] * 2.0 / duration,
        "air_temperature": air[1],
        "air_pressure": air[2],
        "motor_temperatures": _at(heat[0], heat[1], 0.5 * (begin + end)),
        "motor_temperature_rates": (_at(heat[0], heat[1], end) - _at(heat[0], heat[1], begin)) / duration,
        "temperature_sensitivity": _at(heat[0], heat[2], 0.5 * (begin + end)),
        "coil_harmonics": coils @ mean * held,
        "harmonic_variance": np.array([len(time) * (mean @ gram[k, k].real @ mean) for k in places]),
        "spin_ripple": ripple[0],
        "current_ripple": ripple[1],
        "voltage_ripple": ripple[2] * _held(bench.value("motor_ripple_order"), speed * h),
        **_attitude(surroundings),
        "tilt_rate_variance": float(rise @ inverse @ rise) * tilt_noise**2,
        "spin_acceleration_variance": float(slope @ turning_gram[:smooth, :smooth].real @ slope)
        * angle_noise**2,
        "reading_noise": noise,
    }


def _shortened(series: Array) -> Array:
    """Return a Legendre series as the coefficients of a polynomial of `_DEGREE` terms.

    Mean, slope and the change from end to end are kept, so that the mean torque that accelerates the rotor is.
    """
    short = np.zeros(_DEGREE)
    short[: min(len(series), _DEGREE)] = series[:_DEGREE]
    short[3] += series[_DEGREE::2].sum()
    return np.asarray(_TO_POWERS @ short)


def _despiked(readings: Any, design: Any, gram: Any) -> tuple[Any, Any]:
    """Fit columns of readings (n, columns) without their spikes.

    Returns
    -------
    readings : ndarray (n, columns)
        With each spike replaced by what the fit to all the others says there.
    fit : ndarray (columns, terms)
        Coefficients of the columns of `design`.
    """
    across = design.conj().T
    fit = (gram @ (across @ readings)).T
    found = np.zeros(readings.shape, dtype=bool)
    # a spike pulls the fit, which hides the smaller ones until it is gone
    for _ in range(_SPIKE_ROUNDS):
        left = readings - design @ fit.T
        more = _spikes(left) & ~found
        more &= (found | more).mean(axis=0) <= _MOST_SPIKES
        if not more.any():
            break
        found |= more
        readings = readings.copy()
        for column in np.flatnonzero(more.any(axis=0)):
            rows = np.flatnonzero(found[:, column])
            own = design[rows]
            pulled = np.eye(len(rows)) - own @ gram @ own.conj().T
            beyond = np.linalg.lstsq(pulled, left[rows, column], rcond=None)[0]
            readings[rows, column] -= beyond if np.iscomplexobj(readings) else beyond.real
        fit = (gram @ (across @ readings)).T
    return readings, fit


def _spikes(left: Any) -> NDArray[np.bool_]:
    """Return which residuals (n, columns) stand alone, far above all others; none in a column with many of them."""
    size = np.abs(left)
    if not len(size):
        return np.zeros(size.shape, dtype=bool)
    # the median of the absolute value of a Gaussian number, real or complex
    scale = np.median(size, axis=0) / np.where(np.any(left.imag, axis=0), 1.1774, 0.6745)
    # beside the largest ones, which pull a fit towards them so that their neighbours seem to be far off too
    far = size > np.maximum(_SPIKE * scale, 0.3 * size.max(axis=0))
    return np.asarray(far & (far.mean(axis=0) <= _MOST_SPIKES) & (scale > 0.0))


def _without_spikes(values: Array) -> Array:
    """Return readings that hardly change (n, columns) with their spikes replaced by the median."""
    middle = np.median(values, axis=0)
    return np.where(_spikes(values - middle), middle, values)


def _more(x: Array, design: Any, gram: Any, left: Any, degree: int) -> float:
    """Return the mean square that each of four more terms of the polynomial would explain of what a fit leaves."""
    further = np.polynomial.legendre.legvander(x, degree + _FURTHER - 1)[:, degree:].astype(complex)
    further -= design @ (gram @ (design.conj().T @ further))
    basis, _ = np.linalg.qr(further)
    return float(np.sum(np.abs(basis.conj().T @ left) ** 2)) / _FURTHER


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
        changed = abs(s.spin - s.spin_from) > _SPEED_CHANGE
        settling = SPIN_SETTLING if changed else SETTLING
        if changed and s.cone_rate:
            settling += _CONE_SETTLING
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
                    "harmonic_variance": np.ones(len(FORWARD)),
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
                    * next(terms for length, terms in _SPIN_TERMS if duration <= length) ** 5
                    / samples
                    * (noise("spin_angle_noise") / duration**2) ** 2,
                    "reading_noise": np.array([noise(name) for name in READING_NOISES]),
                }
            )
    return Windows(**{item.name: np.array([row[item.name] for row in rows]) for item in fields(Windows)})
