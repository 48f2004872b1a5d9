"""Windows: motion as polynomials in time and harmonics of the spin angle, voltages as means; groups; and coverage."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gyrowheel_analysis.channels import CHANNELS
from gyrowheel_analysis.criteria import CLEAR_HARMONIC, NEARLY_ALL
from gyrowheel_analysis.reduction.motor_temperature import MOTOR_THERMAL
from gyrowheel_analysis.reduction.quality import READING_NOISES
from gyrowheel_analysis.reduction.samples import Array
from gyrowheel_core.units import DEG
from gyrowheel_sim.environment import Environment

#: Speeds within this fraction of the slowest of a group are the same.
SAME_SPEED = 0.04
#: A tilt below this has no direction [rad].
UPRIGHT = 0.3 * DEG


def speed_groups(spin_rate: Any) -> list[NDArray[np.int64]]:
    """Return the indices of the windows of each speed [rad/s], slowest first; speeds within 4 % are the same."""
    rates = np.asarray(spin_rate, dtype=float)
    groups: list[list[int]] = []
    for index in np.argsort(rates, kind="stable"):
        if groups and rates[index] <= (1.0 + SAME_SPEED) * rates[groups[-1][0]]:
            groups[-1].append(int(index))
        else:
            groups.append([int(index)])
    return [np.array(group) for group in groups]


def direction_groups(tilt: Any) -> list[NDArray[np.int64]]:
    """Return the indices of the windows of each octant of tilt direction; upright ones first."""
    octant = octants(tilt)
    return [np.flatnonzero(octant == value) for value in np.unique(octant)]


def octants(tilt: Any) -> NDArray[np.int64]:
    """Return the octant of each tilt direction (n,), 0 about the x axis; -1 where the rotor is upright."""
    z = np.asarray(tilt, dtype=complex)
    eighth = np.round(np.angle(z) / (math.pi / 4.0)).astype(np.int64) % 8
    return np.where(np.abs(z) < UPRIGHT, -1, eighth)


def masks(groups: Sequence[NDArray[np.int64]], count: int) -> list[NDArray[np.bool_]]:
    """Return groups of indices as masks of length `count`."""
    result = []
    for group in groups:
        mask = np.zeros(count, dtype=bool)
        mask[group] = True
        result.append(mask)
    return result


#: Harmonics of the coil voltages that are compared, as the channels ask for: an effect that turns with the rotor acts
#: forward.
FORWARD = tuple(sorted({channel.order for channel in CHANNELS.values() if channel.order}))
#: Harmonics of the motion, backward and forward.
HARMONICS = (*(-order for order in reversed(FORWARD)), *FORWARD)
DEGREE = 5  # of the polynomials in time
MODULATION = 3  # terms of the polynomial in time of a harmonic's amplitude
_SAME_TILT, _SAME_SPEED = 0.1 * DEG, 0.004  # steps, of the speed relative: holds within one are alike

#: Mean over -1..1, and difference between the ends, of the powers of x.
MEAN = np.array([1.0 / (k + 1) if k % 2 == 0 else 0.0 for k in range(DEGREE + 1)])
RISE = np.array([2.0 if k % 2 else 0.0 for k in range(DEGREE + 1)])


def waves_of(angle: Array, powers: Array) -> Array:
    """Return cosine and sine of the orders `FORWARD` of an angle, each times the columns of `powers`: (n, terms)."""
    wave = np.cos(angle) + 1j * np.sin(angle)
    waves = (wave**order for order in FORWARD)
    return np.hstack([part[:, None] * powers for wave in waves for part in (wave.real, wave.imag)])


def still_row() -> dict[str, Any]:
    """Return the attributes of a window without motion, voltages, noise and temperatures, for `Windows.of`."""
    orders, harmonics = len(FORWARD), np.zeros((len(HARMONICS), MODULATION), dtype=complex)
    return dict.fromkeys((own.name for own in fields(Windows)), 0.0) | {
        **dict.fromkeys(("coil_voltage", "spin_ripple", "current_ripple", "voltage_ripple"), 0.0j),
        "tilt": np.zeros(DEGREE + 1, dtype=complex),
        "tilt_harmonics": harmonics,
        "spin": np.zeros(DEGREE),
        "current_harmonics": harmonics,
        "motor_temperatures": np.zeros(2),
        "motor_temperature_rates": np.zeros(2),
        "temperature_sensitivity": np.zeros((2, len(MOTOR_THERMAL))),
        "coil_harmonics": np.zeros(orders, dtype=complex),
        "angle_harmonics": np.zeros(orders, dtype=complex),
        "harmonic_variance": np.ones(orders),
        "hum_variance": np.zeros((2, orders)),
        "leakage_variance": np.zeros(orders),
        "reading_noise": np.zeros(len(READING_NOISES)),
        "tilt_swing": 0.0j,
        "volt_swing": 0.0j,
        "current_swing": 0.0,
    }


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
        Temperatures of the motor's winding and magnets, computed from the recorded current [K].
    motor_temperature_rates : ndarray (n, 2)
        Slopes of these temperatures [K/s].
    temperature_sensitivity : ndarray (n, 2, 4)
        Derivatives of these temperatures by the parameters of `MOTOR_THERMAL`.
    coil_harmonics : complex ndarray (n, 2)
        Amplitudes of exp(i h theta_z) in the coil voltages x + i y as they act between two samples, h in `FORWARD` [V].
    angle_harmonics : complex ndarray (n, 2)
        Amplitudes of exp(i h theta_z) in the reading of the angle less its smooth part, h in `FORWARD` [rad].
    harmonic_variance : ndarray (n, 2)
        Variance of these amplitudes, and of those of the tilt, relative to that of a mean: above one where a window
        has so few revolutions that harmonics and slow motion are hard to separate.
    hum_variance : ndarray (n, 2, 2)
        Variance that hum of the mains adds to the amplitudes of exp(i h theta_z) in tilt [rad^2] and coil voltages
        [V^2], h in `FORWARD`.
    leakage_variance : ndarray (n, 2)
        Variance of the coil torques at these orders that motion at other frequencies leaves [N^2 m^2].
    spin_ripple, current_ripple, voltage_ripple : complex ndarray (n,)
        Amplitude of exp(i p theta_z) in spin rate [rad/s], motor current [A] and motor voltage [V]; p is the order of
        the motor's ripple.
    up : ndarray (n,)
        Component along case z of the unit vector that points up: +1 upright, -1 inverted.
    up_across, home_x, home_y : complex ndarray (n,)
        Components across case z of that vector, and of the horizontal home axes.
    table_rate : ndarray (n,)
        Commanded rate of the rate table about the vertical [rad/s].
    tilt_rate_variance : ndarray (n,)
        Variance of the mean tilt rate, one axis, from white noise of the tilt readings [rad^2/s^2].
    spin_acceleration_variance : ndarray (n,)
        Variance of the mean spin acceleration from white noise of the angle readings [rad^2/s^4].
    reading_noise : ndarray (n, 6)
        Standard deviation of the white noise of the readings of `READING_NOISES` in the recording [SI].
    tilt_swing, volt_swing : complex ndarray (n,)
        What tilt [rad] and coil voltages [V], weighted as in the mean tilt rate, exceed their means by: with the
        constants of the bench file these are part of that rate (`mean_rates`).
    current_swing : ndarray (n,)
        The same of the motor current in the mean spin acceleration [A].
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
    angle_harmonics: NDArray[np.complex128]
    harmonic_variance: Array
    hum_variance: Array
    leakage_variance: Array
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
    tilt_swing: NDArray[np.complex128]
    volt_swing: NDArray[np.complex128]
    current_swing: Array

    def noise(self, name: str) -> Array:
        """Return the white noise of a reading, by its name in the bench file, (n,) [SI]."""
        return np.asarray(self.reading_noise[:, READING_NOISES.index(name)])

    def __len__(self) -> int:
        """Return the number of windows."""
        return len(self.start)

    @classmethod
    def of(cls, rows: Sequence[Mapping[str, Any]]) -> Windows:
        """Return windows from mappings of the attributes, one per window, possibly none."""
        names = [item.name for item in fields(cls)]
        if rows:
            return cls(**{name: np.array([row[name] for row in rows]) for name in names})
        row = still_row()
        return cls(**{name: np.zeros((0, *np.shape(row[name]))) for name in names})

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
        return self.tilt @ MEAN[: self.tilt.shape[1]]

    @property
    def mean_tilt_rate(self) -> NDArray[np.complex128]:
        """Mean tilt rate [rad/s]."""
        return self.tilt @ RISE[: self.tilt.shape[1]] / self.duration

    @property
    def mean_spin(self) -> Array:
        """Mean spin rate [rad/s]."""
        return self.spin @ MEAN[: self.spin.shape[1]]

    @property
    def mean_spin_acceleration(self) -> Array:
        """Mean spin acceleration [rad/s^2]."""
        return self.spin @ RISE[: self.spin.shape[1]] / self.duration

    @property
    def moving(self) -> NDArray[np.bool_]:
        """Whether the tilt moves (a cone) or the speed changes (a sweep), beyond the settling of a hold."""
        return (np.abs(self.mean_tilt_rate) > 0.5 * DEG) | (np.abs(self.mean_spin_acceleration) > 1.0)


def without_noise(windows: Windows) -> Windows:
    """Return the windows without harmonics, rates and accelerations that are not well above the noise of the readings.

    A torque computed from noise is noise, and whatever multiplies it (a gain, a scale, a damping, a moment of inertia)
    would be fitted to noise. An inertia would be too small by the share of noise in the mean square of the
    accelerations (errors in variables), and so would all other scales. Harmonics that are well above it have noise,
    too: where many holds repeat one tilt and speed, that noise would in the end outweigh the priors of all parameters
    that leave their mean unchanged. In holds of one tilt and speed they are therefore those of the mean of these holds,
    unless one differs from it by more than noise.
    """
    v, n = windows.noise, windows.samples
    alike = _alike(windows)
    modulation = np.array([[MEAN[j + k] for k in range(MODULATION)] for j in range(MODULATION)])

    def kept(amplitudes: Any, noise: Array) -> Any:
        """Amplitudes (n, harmonics, terms) that are above the noise of a reading, both parts together."""

        def clear(of: Any) -> Any:
            power = np.einsum("nhj,jk,nhk->nh", of.conj(), modulation, of).real
            return (power > CLEAR_HARMONIC**2 * 2.0 * (noise**2 / n)[:, None])[:, :, None]

        usual = _usual(amplitudes, n, alike)
        steady = np.where(clear(amplitudes - usual), amplitudes, usual)
        return np.where(clear(steady), steady, 0.0)

    def above(amplitude: Any, noise: Array) -> Any:
        usual, least = _usual(amplitude, n, alike), CLEAR_HARMONIC * noise / np.sqrt(n)
        steady = np.where(np.abs(amplitude - usual) > least, amplitude, usual)
        return np.where(np.abs(steady) > least, steady, 0.0)

    def level(series: Any, rate: Any, variance: Array) -> Any:
        """Return a polynomial in time (n, terms) without its change from end to end where that is noise."""
        result = series.copy()
        noisy = np.abs(rate) ** 2 < CLEAR_HARMONIC**2 * variance
        result[:, 1] -= 0.5 * np.where(noisy, rate * windows.duration, 0.0)
        return result

    return replace(
        windows,
        spin=level(windows.spin, windows.mean_spin_acceleration, windows.spin_acceleration_variance),
        # both parts together
        tilt=level(windows.tilt, windows.mean_tilt_rate, 2.0 * windows.tilt_rate_variance),
        tilt_harmonics=kept(windows.tilt_harmonics, v("tilt_noise")),
        # the two signs of a harmonic of a real reading share its noise
        current_harmonics=kept(windows.current_harmonics, math.sqrt(0.5) * v("motor_current_noise")),
        spin_ripple=above(windows.spin_ripple, v("spin_rate_noise")),
        current_ripple=above(windows.current_ripple, v("motor_current_noise")),
        voltage_ripple=above(windows.voltage_ripple, v("motor_voltage_noise")),
    )


def _alike(windows: Windows) -> NDArray[np.int64]:
    """Return a number for every window (n,): that of the holds of its tilt and speed; a separate one if it moves."""
    tilt = windows.mean_tilt / _SAME_TILT
    key = np.column_stack(
        [np.round(tilt.real), np.round(tilt.imag), np.round(np.log(np.abs(windows.mean_spin)) / _SAME_SPEED)]
    )
    numbers = np.unique(key, axis=0, return_inverse=True)[1].reshape(-1) if len(key) else np.zeros(0, int)
    own = len(key) + np.arange(len(key))
    return np.unique(np.where(windows.moving, own, numbers), return_inverse=True)[1].reshape(-1)


def _usual(values: Any, samples: Array, alike: NDArray[np.int64]) -> Any:
    """Return the average values (n, ...), weighted by samples, of the windows that are alike."""
    flat = np.asarray(values).reshape(len(alike), math.prod(np.shape(values)[1:]))
    total = np.zeros((int(alike.max(initial=-1)) + 1, flat.shape[1]), dtype=flat.dtype)
    np.add.at(total, alike, flat * samples[:, None])
    weight = np.bincount(alike, weights=samples, minlength=len(total))
    return (total / weight[:, None])[alike].reshape(np.shape(values))


def concatenate(parts: Sequence[Windows]) -> Windows:
    """Join windows of several recordings (times stay those of each recording)."""
    return Windows(*(np.concatenate([getattr(p, item.name) for p in parts]) for item in fields(Windows)))


def attitude(environment: Environment) -> dict[str, Any]:
    """Return the columns that describe the attitude of the rig."""
    first, second = environment.home
    return {
        "up": environment.up,
        "up_across": environment.up_across,
        "home_x": first,
        "home_y": second,
        "table_rate": environment.table_rate,
    }


_SHOWN = 0.05  # s


@dataclass(frozen=True)
class MissedVoltages:
    """Voltages of the loop that are not in a recording, since it has fewer samples than the loop gives voltages.

    Attributes
    ----------
    samples, voltages : float
        Samples of the recording and voltages of the loop in a second [1/s].
    noise : float
        Noise of the mean torque of the coils in a window that comes of it, in the middle of all windows [N·m].
    """

    samples: float
    voltages: float
    noise: float

    @property
    def part(self) -> float:
        """Part of the voltages that is missing."""
        return 1.0 - self.samples / self.voltages


@dataclass(frozen=True)
class Coverage:
    """Use of the steady motion in recordings. Steady is all but ramps and the settling after them.

    Attributes
    ----------
    recorded : float
        Length of the recordings [s].
    used : float
        Steady motion that lies in windows [s].
    left_out : dict of str to float
        Steady motion outside of windows [s], by reason.
    assumed : tuple of str
        Quantities that were never measured, and the assumption instead.
    missed : MissedVoltages or None
        What a rate below that of the loop costs; of several recordings, of that with the lowest one.
    """

    recorded: float = 0.0
    used: float = 0.0
    left_out: dict[str, float] = field(default_factory=dict)
    assumed: tuple[str, ...] = ()
    missed: MissedVoltages | None = None

    @property
    def steady(self) -> float:
        """Steady motion [s]."""
        return self.used + sum(self.left_out.values())

    @property
    def complete(self) -> bool:
        """Whether nearly all of the steady motion is used, and nothing had to be assumed."""
        return not self.assumed and self.used >= NEARLY_ALL * self.steady

    @classmethod
    def of(cls, parts: Iterable[Coverage]) -> Coverage:
        """Return the coverage of several recordings together."""
        parts = list(parts)
        recorded, used, left_out = 0.0, 0.0, dict[str, float]()
        for part in parts:
            recorded, used = recorded + part.recorded, used + part.used
            for why, length in part.left_out.items():
                left_out[why] = left_out.get(why, 0.0) + length
        # each once, in order
        assumed = dict.fromkeys(what for part in parts for what in part.assumed)
        missed = max((part.missed for part in parts if part.missed), key=lambda own: own.part, default=None)
        return cls(recorded, used, left_out, tuple(assumed), missed)

    def sentence(self) -> str:
        """Return it in one sentence."""
        reasons = [
            f"{length:.1f} s {why}"
            for why, length in sorted(self.left_out.items(), key=lambda item: -item[1])
            if length >= _SHOWN
        ]
        never = f"; not measured: {', '.join(self.assumed)}" if self.assumed else ""
        if not reasons:
            return (
                f"All {self.used:.0f} s of steady motion take part (of {self.recorded:.0f} s recorded){never}"
            )
        return (
            f"{self.used:.0f} of {self.steady:.0f} s of steady motion take part (of {self.recorded:.0f} s recorded); "
            f"left out: {', '.join(reasons)}{never}"
        )

    def to_json(self) -> dict[str, Any]:
        """Return it as a JSON object; all in seconds."""
        return asdict(self) | {"steady": self.steady}
