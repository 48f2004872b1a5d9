"""One window: the polynomials and harmonics that describe its samples, and whether the motion in it has settled."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gyrowheel_analysis.criteria import (
    EDGE_OF_MOTION,
    FURTHER_TERMS,
    RESTLESS_CURRENT,
    TOO_FEW_TERMS,
    UNSETTLED_ANGLE,
    UNSETTLED_TILT,
)
from gyrowheel_analysis.reduction.mean_rates import (
    acceleration_variance,
    mean_acceleration,
    tilt_rate_weights,
)
from gyrowheel_analysis.reduction.motor_temperature import interpolated
from gyrowheel_analysis.reduction.outliers import noise_excess
from gyrowheel_analysis.reduction.quality import READING_NOISES, SLOW, despiked, without_spikes
from gyrowheel_analysis.reduction.samples import Array, Samples, unseen_noise
from gyrowheel_analysis.reduction.windows import (
    DEGREE,
    FORWARD,
    HARMONICS,
    MEAN,
    MODULATION,
    RISE,
    attitude,
    waves_of,
)
from gyrowheel_sim.bench import Bench
from gyrowheel_sim.environment import Environment
from gyrowheel_sim.instruments import held_factor

#: Terms of the polynomial of the spin angle, by the longest window [s] that has them: long windows contain the response
#: of the spin loop to a change of tilt.
_SPIN_TERMS = ((0.5, 4), (1.0, 8), (math.inf, 12))
SHORTEST = 0.16  # s, of a window
FEWEST_REVOLUTIONS = 4  # of a window; with fewer, harmonics and slow motion are hard to separate
#: Fraction of the samples of a window that must be present.
FEWEST_SAMPLES = 0.7
_FURTHER = 4  # terms of the polynomials that show whether a motion has settled
#: Samples at each end of a window whose mean residual shows that a motion ended or began there.
_EDGE_SAMPLES = (4, 8, 16)
#: Fitted columns: tilt, motor current, coil voltages, spin rate, motor voltage.
_TILT, _CURRENT, _COIL, _SPIN, _MOTOR = range(5)
_MEDIAN_OF_SQUARES = math.log(2.0)  # of complex noise, over their mean
#: From a Legendre series of `DEGREE` terms to powers of x.
_TO_POWERS = np.zeros((DEGREE, DEGREE))
for _term in range(DEGREE):
    _TO_POWERS[: _term + 1, _term] = np.polynomial.legendre.leg2poly(np.eye(DEGREE)[_term])[: _term + 1]


def fit_window(
    data: Samples,
    i: int,
    j: int,
    periods: tuple[float, float, float],
    bench: Bench,
    heat: tuple[Array, Array, Array],
    noise: Array,
    *,
    weighed: bool = True,
) -> dict[str, Any] | None:
    """Reduce samples i .. j-1, shortened to whole revolutions.

    `periods` are the sampling period of the recording, the duration of a held voltage by its stamp, and the period of
    the loop [s]; `heat` and `noise` are the results of `motor_temperatures` and `reading_noise`; for `weighed` see
    `reduce_and_account`. Returns the fields of `Windows` for this window except ``segment``, and two flags:
    ``unsettled`` if the polynomials cannot follow the motion, ``left`` if another motion begins at the end; with one of
    them, ``spin`` alone is with it. Returns None if there are too few samples or revolutions.
    """
    h, hold, loop = periods
    if j - i < 3 * FEWEST_REVOLUTIONS:
        return None
    angle = np.unwrap(data.readings.spin_angle[i:j])
    turns = math.floor((angle[-1] - angle[0]) / (2.0 * math.pi))
    if turns < FEWEST_REVOLUTIONS:
        return None
    # the last sample belongs to the interval before it, so n samples cover n periods
    stop = int(np.searchsorted(angle, angle[0] + 2.0 * math.pi * turns - 0.5 * (angle[1] - angle[0])))
    j, angle = i + stop, angle[:stop]
    time, own = data.time[i:j], data.readings[i:j]
    if len(time) < FEWEST_SAMPLES * (time[-1] - time[0]) / h or time[-1] - time[0] < 0.5 * SHORTEST:
        return None  # too many samples lost
    # a voltage reading belongs to the interval of the loop that ends with it, and represents one sampling period
    begin, end = float(time[0]) - 0.5 * (h + hold), float(time[-1]) + 0.5 * (h - hold)
    duration = end - begin
    x = (time - 0.5 * (begin + end)) / (0.5 * duration)
    degree = DEGREE + 1
    powers = np.vander(x, degree, increasing=True)
    waves = waves_of(angle, powers[:, :MODULATION])
    design = np.hstack([powers, waves])
    # the smooth part of the speed comes from the angle, which gives its slope far better
    readings = np.column_stack(  # in the order of `_TILT`, `_CURRENT`, ...
        [
            own.tilt_x + 1j * own.tilt_y,
            own.motor_current,
            own.coil_voltage_x + 1j * own.coil_voltage_y,
            own.spin_rate,
            own.motor_voltage,
        ]
    )
    gram = np.linalg.inv(design.T @ design)
    commanded = {}
    if data.commanded is not None:
        commanded[_COIL] = data.commanded.at(slice(i, j), 0) + 1j * data.commanded.at(slice(i, j), 1)
    readings, fit, left = despiked(readings, design, gram, commanded)
    volts = READING_NOISES.index("coil_voltage_noise")
    noise = noise.copy()
    noise[volts] = unseen_noise(left[:, _COIL], noise[volts], loop / h)
    harmonics = _harmonics(fit[:, degree:])
    smooth = next(terms for length, terms in _SPIN_TERMS if duration <= length)
    spin_ripple, current_ripple, voltage_ripple = _ripple(
        left[:, (_SPIN, _CURRENT, _MOTOR)].real, angle, bench
    )
    series = np.polynomial.legendre.legvander(x, max(degree, smooth) + _FURTHER - 1)
    legendre = series[:, :smooth]
    turning = np.hstack([legendre, waves])
    turning_gram = np.linalg.inv(turning.T @ turning)
    _, turned, angle_left = despiked(angle[:, None], turning, turning_gram)
    tilt_noise, angle_noise, current_noise, motor_noise = (
        noise[READING_NOISES.index(name)]
        for name in ("tilt_noise", "spin_angle_noise", "motor_current_noise", "motor_voltage_noise")
    )
    tail = _more(series[:, degree : degree + _FURTHER], design, gram, left[:, _TILT]) / (2.0 * tilt_noise**2)
    angle_tail = _more(series[:, smooth : smooth + _FURTHER], turning, turning_gram, angle_left[:, 0])
    # the coils turn the rotor, and the motor the shaft, some samples before either has moved
    motor = left[:, _CURRENT].real / current_noise + 1j * left[:, _MOTOR].real / motor_noise
    begins, ends = (
        _sharp(left[:, _TILT], tilt_noise) | _sharp(left[:, _COIL], noise[volts]) | _sharp(motor, 1.0)
    ).tolist()
    unsettled = (
        tail > UNSETTLED_TILT
        or angle_tail > UNSETTLED_ANGLE * angle_noise**2
        or np.mean(np.abs(left[:, _CURRENT]) ** 2) - 2.0 * abs(current_ripple) ** 2
        > (RESTLESS_CURRENT * current_noise) ** 2
        or begins
    )
    if not unsettled and tail > FURTHER_TERMS:
        unsettled = _beyond(x, waves, readings[:, _TILT]) > 2.0 * TOO_FEW_TERMS * tilt_noise**2
    spin = np.asarray(np.polynomial.legendre.legder(turned[0, :smooth]), dtype=np.float64) * 2.0 / duration
    spin_left, spin_noise = angle_left[:, 0], "spin_angle_noise"
    if of_speed := data.summed and "spin_rate" not in data.absent:
        # the integral of the speed is a random walk by its noise: the polynomial is fitted to the speed itself
        spin, spin_left = _of_speed(readings[:, _SPIN].real, legendre[:, :-1], waves)
        spin_noise = "spin_rate_noise"
    if unsettled or ends:
        return {"unsettled": unsettled, "left": ends, "spin": _shortened(spin)}
    factors = _outlier_factors(left, angle_left[:, 0], noise) if weighed else {}
    drive, per_unit, drive_noise = _drive(
        readings, np.polynomial.legendre.legval(x, spin), data.absent, bench
    )
    acceleration, swing = mean_acceleration(spin, spin_left, drive, x, duration, of_speed=of_speed)
    wave = np.cos(math.pi * x)
    angle_deviation = (
        _deviation(spin_noise, np.sin(math.pi * x), noise, factors) * duration / (2.0 * math.pi)
        if of_speed
        else _deviation(spin_noise, wave, noise, factors)
    )
    spin_variance = acceleration_variance(
        duration, len(time), angle_deviation, per_unit * _deviation(drive_noise, wave, noise, factors)
    )
    means = readings.mean(axis=0)
    speed = float(means[_SPIN].real)
    *rows, of_tilt, of_volts = tilt_rate_weights(x, design, gram, duration, hold / duration, bench, speed)
    rate = rows[0] @ readings[:, _TILT] + rows[1] @ readings[:, _COIL]
    tilt = fit[_TILT, :degree].copy()
    tilt[1] += 0.5 * (rate * duration - tilt @ RISE)
    rate_variance = sum(
        float(np.sum(np.abs(row) ** 2)) * _deviation(name, row, noise, factors) ** 2
        for row, name in zip(rows, ("tilt_noise", "coil_voltage_noise"), strict=True)
    )
    if any(part.max() > 1.0 for part in factors.values()):
        noise = noise * np.sqrt([factors[name].mean() for name in READING_NOISES])
    slow = without_spikes(np.column_stack([own[name] for name in SLOW]))
    coil = slow[:, SLOW.index("coil_temperature")]
    warming = float(x @ coil - x.sum() * coil.mean()) / float(x @ x - x.sum() * x.mean())
    last = [e for e in data.environment if e.time <= begin + 1e-6]
    surroundings = last[-1] if last else Environment()
    temperatures = dict(zip(SLOW, slow.mean(axis=0), strict=True))
    forward = [HARMONICS.index(order) for order in FORWARD]
    mean = MEAN[:MODULATION]
    held = held_factor(np.array(FORWARD), speed * hold)
    coil_held = bench.value("coil_constant") * held
    heating = interpolated(heat[0], heat[1], end) - interpolated(heat[0], heat[1], begin)
    return {
        "unsettled": False,
        "left": False,
        "start": begin,
        "duration": duration,
        "samples": float(len(time)),
        "tilt": tilt,
        "tilt_harmonics": harmonics[_TILT],
        "spin": _shortened(spin, acceleration * duration),
        "current_harmonics": harmonics[_CURRENT],
        "coil_voltage": complex(means[_COIL] - _leaked(waves, fit[_COIL, degree:], angle, turns)),
        "motor_voltage": float(means[_MOTOR].real),
        "motor_current": float(means[_CURRENT].real),
        **temperatures,
        "coil_temperature_rate": warming * 2.0 / duration,
        "motor_temperatures": interpolated(heat[0], heat[1], 0.5 * (begin + end)),
        "motor_temperature_rates": heating / duration,
        "temperature_sensitivity": interpolated(heat[0], heat[2], 0.5 * (begin + end)),
        "coil_harmonics": harmonics[_COIL, forward] @ mean * held,
        "angle_harmonics": _harmonics(turned[:, smooth:])[0, forward] @ mean,
        "harmonic_variance": len(time) * _wave_variance(gram[degree:, degree:], mean),
        "hum_variance": np.zeros((2, len(FORWARD))),
        "leakage_variance": _leakage(
            design,
            gram,
            degree,
            left,
            (noise[READING_NOISES.index("tilt_noise")], noise[volts]),
            resistances(bench, speed),
            coil_held,
        )
        if weighed
        else np.zeros(len(FORWARD)),
        "spin_ripple": spin_ripple,
        "current_ripple": current_ripple,
        "voltage_ripple": voltage_ripple * held_factor(bench.value("motor_ripple_order"), speed * hold),
        **attitude(surroundings),
        "tilt_rate_variance": rate_variance,
        "spin_acceleration_variance": spin_variance,
        "reading_noise": noise,
        "tilt_swing": of_tilt @ readings[:, _TILT],
        "volt_swing": of_volts @ readings[:, _COIL],
        "current_swing": swing * bench.axial_inertia / bench.value("motor_constant"),
    }


def _outlier_factors(left: Any, turned: Array, noise: Array) -> dict[str, Array]:
    """Return the factors by which outliers raise the square of the `noise` of a recording, (n,) by its name.

    `left` (n, 5) are the readings of a window without the motion, `turned` (n,) is the angle without it. The voltages
    of the coils answer the noise of the tilt.
    """
    shown = {
        "tilt_noise": left[:, _TILT],
        "spin_angle_noise": turned,
        "spin_rate_noise": left[:, _SPIN].real,
        "coil_voltage_noise": left[:, _COIL],
        "motor_voltage_noise": left[:, _MOTOR].real,
        "motor_current_noise": left[:, _CURRENT].real,
    }
    return {
        name: noise_excess(shown[name], 0.0 if name == "coil_voltage_noise" else own)
        for name, own in zip(READING_NOISES, noise.tolist(), strict=True)
    }


def _weighed(row: Any, factor: Array) -> float:
    """Return by what a combination `row` (n,) of samples is noisier whose noise is raised by a `factor` (n,)."""
    square = np.abs(row) ** 2
    return float(square @ factor) / float(square.sum())


def _beyond(x: Array, waves: Array, tilt: Any) -> float:
    """Return what `_FURTHER` more terms in the polynomial of a tilt do not follow, as `_more` returns it."""
    legendre = np.polynomial.legendre.legvander(x, DEGREE + 2 * _FURTHER)
    design, further = np.hstack([legendre[:, :-_FURTHER], waves]), legendre[:, -_FURTHER:]
    gram = np.linalg.inv(design.T @ design)
    return _more(further, design, gram, tilt - design @ (gram @ (design.T @ tilt)))


def _of_speed(speed: Array, legendre: Any, waves: Array) -> tuple[Array, Array]:
    """Return the Legendre series of a speed, and what it and the waves leave of the speed."""
    design = np.hstack([legendre, waves])
    fit, *_ = np.linalg.lstsq(design, speed, rcond=None)
    return np.asarray(fit[: legendre.shape[1]]), np.asarray(speed - design @ fit)


def _drive(readings: Any, speed: Any, absent: frozenset[str], bench: Bench) -> tuple[Array, float, str]:
    """Return the acceleration that the motor causes at the samples (n,) [rad/s²].

    It follows from the current, or else from the voltage: returned with the acceleration per unit of that reading, and
    the name of its noise. `readings` (n, 5) are those of a window, `speed` (n,) is its smooth speed [rad/s].
    """
    constant = bench.value("motor_constant")
    per_ampere = constant / bench.axial_inertia
    if "motor_current" not in absent:
        return per_ampere * readings[:, _CURRENT].real, per_ampere, "motor_current_noise"
    per_volt = 0.0 if "motor_voltage" in absent else per_ampere / bench.value("motor_resistance")
    return per_volt * (readings[:, _MOTOR].real - constant * speed), per_volt, "motor_voltage_noise"


def _deviation(name: str, row: Any, noise: Array, factors: Mapping[str, Array]) -> float:
    """Return the deviation of the noise of a reading, as a combination `row` (n,) of its samples has it."""
    burst = _weighed(row, factors[name]) if factors else 1.0
    return float(noise[READING_NOISES.index(name)]) * math.sqrt(burst)


def _shortened(series: Array, rise: float | None = None) -> Array:
    """Return the Legendre series of a speed as the coefficients of a polynomial of `DEGREE` terms.

    Mean and slope are preserved. The change from end to end is `rise`, by default that of the series: the torque that
    accelerates the rotor follows from it.
    """
    short = np.zeros(DEGREE)
    short[: min(len(series), DEGREE)] = series[:DEGREE]
    short[3] = (series[1::2].sum() if rise is None else 0.5 * rise) - short[1]
    return np.asarray(_TO_POWERS @ short)


def _leaked(waves: Array, fit: Any, angle: Array, turns: int) -> complex:
    """Return what harmonics add to a mean by their change in the window, and by what it has beyond whole revolutions.

    In a cone the torque twice a revolution turns; what that leaves in the mean has no place in the mean torque that the
    motion takes. `waves` (n, terms) are those of a window at its `angle` (n,), `fit` (terms,) are their amplitudes.
    """
    varying = fit.reshape(-1, MODULATION).copy()
    steady = varying @ MEAN[:MODULATION]
    varying[:, 0] -= steady
    step = (angle[-1] - angle[0]) / (len(angle) - 1)
    beyond = len(angle) - 2.0 * math.pi * turns / step  # samples, up to half of one at the end
    last = waves_of(angle[-1:] + 0.5 * step * (1.0 - beyond), np.ones((1, 1)))[0]
    return complex(waves.mean(axis=0) @ varying.ravel() + beyond / len(angle) * (last @ steady))


def _harmonics(fit: Any) -> NDArray[np.complex128]:
    """Return the amplitudes of the `HARMONICS` (columns, harmonics, `MODULATION`) from those of the `_waves`."""
    cosine, sine = np.moveaxis(fit.reshape(len(fit), len(FORWARD), 2, MODULATION), 2, 0)
    result = np.empty((len(fit), len(HARMONICS), MODULATION), dtype=complex)
    for k, order in enumerate(FORWARD):
        result[:, HARMONICS.index(order)] = 0.5 * (cosine[:, k] - 1j * sine[:, k])
        result[:, HARMONICS.index(-order)] = 0.5 * (cosine[:, k] + 1j * sine[:, k])
    return result


def _wave_variance(gram: Array, mean: Array) -> Array:
    """Return the variance of the mean amplitude of each of the orders `FORWARD` in white noise of unit variance."""
    blocks = gram.reshape(len(FORWARD), 2, MODULATION, len(FORWARD), 2, MODULATION)
    return np.array(
        [
            0.25 * sum(mean @ blocks[k, part, :, k, part] @ mean for part in (0, 1))
            for k in range(len(FORWARD))
        ]
    )


def resistances(bench: Bench, spin_rate: Any) -> list[Any]:
    """Return the torque of a tilt over the tilt [N m/rad] at each of the orders `FORWARD` of a spin rate [rad/s]."""
    return [
        bench.flexure_stiffness
        + (order * bench.precession_inertia - order**2 * bench.transverse_inertia) * spin_rate**2
        for order in FORWARD
    ]


def _leakage(
    design: Array,
    gram: Array,
    degree: int,
    left: Any,
    noise: tuple[float, float],
    resistance: list[float],
    coil: Any,
) -> Array:
    """Return the variance of each part of a coil torque at the orders `FORWARD` by motion at other frequencies [N²m²].

    The loop answers the noise of its readings, so that coils and rotor move at all frequencies, most of all at that of
    the nutation. A window of few revolutions does not separate them from a harmonic: the torque that the motion needs
    grows with its frequency, so that there the leakage of the coils' torque does not cancel that of the motion. The
    spectrum of the residuals `left` shows it; white `noise` of tilt and coil voltage is counted elsewhere. `coil` are
    the torques per volt.
    """
    n = len(design)
    waves = np.fft.rfft(
        design, axis=0
    )  # of real columns: those at negative frequencies are the conjugate ones
    leverage = np.einsum("kp,kp->k", waves.conj() @ gram, waves).real / n
    between = leverage < 0.5  # the fit leaves nothing at the frequencies that it describes
    ahead, back = np.flatnonzero(between), np.flatnonzero(between[1 : (n + 1) // 2]) + 1
    tilt, voltage = np.fft.fft(left[:, [_TILT, _COIL]], axis=0).T
    mean = MEAN[:MODULATION]
    blocks = gram[degree:].reshape(len(FORWARD), 2, MODULATION, -1)
    result = []
    for k, (stiff, constant) in enumerate(zip(resistance, coil, strict=True)):
        power = np.abs(constant * voltage - stiff * tilt) ** 2 / n
        white = 2.0 * ((stiff * noise[0]) ** 2 + (abs(constant) * noise[1]) ** 2)
        weights = 0.5 * (mean @ blocks[k, 0] - 1j * (mean @ blocks[k, 1]))
        # the response of the estimate to each frequency, positive and negative
        positive, negative = np.abs(waves.conj() @ weights) ** 2, np.abs(waves @ weights) ** 2
        leaked = (power[ahead] / (1.0 - leverage[ahead]) - white) @ positive[ahead]
        leaked += (power[n - back] / (1.0 - leverage[back]) - white) @ negative[back]
        result.append(max(0.5 * float(leaked) / n, 0.0))
    return np.array(result)


def _more(further: Any, design: Array, gram: Array, left: Any) -> float:
    """Return the mean square of the residuals that each of some `further` terms (n, `_FURTHER`) would explain."""
    # the residuals are orthogonal to the design, so only the square of the terms must be projected
    shared = design.T @ further
    square = further.T @ further - shared.T @ gram @ shared
    along = further.T @ left
    return float(np.real(along.conj() @ np.linalg.solve(square, along))) / _FURTHER


def _sharp(left: Any, noise: float) -> NDArray[np.bool_]:
    """Whether complex residuals (n,) are large at the start and at the end, as where a motion ends or begins."""
    found = np.zeros(2, dtype=bool)
    for count in _EDGE_SAMPLES:
        ends, inner = np.array([left[:count], left[-count:]]), left[count:-count]
        blocks = inner[: len(inner) // count * count].reshape(-1, count)
        usual, off = (np.abs(part.sum(axis=1)) ** 2 for part in (blocks, ends))
        # a burst of noise must not conceal a motion
        usual = usual[usual <= EDGE_OF_MOTION * np.median(usual) / _MEDIAN_OF_SQUARES]
        found |= off > EDGE_OF_MOTION * max(float(usual.mean()), 2.0 * count * noise**2)
    return found


def _ripple(left: Array, angle: Array, bench: Bench) -> NDArray[np.complex128]:
    """Return the amplitudes of the motor ripple in the residuals of the smooth part and harmonics, by column."""
    wave = np.exp(-1j * bench.value("motor_ripple_order") * angle)
    return np.asarray(wave @ left / len(angle), dtype=np.complex128)
