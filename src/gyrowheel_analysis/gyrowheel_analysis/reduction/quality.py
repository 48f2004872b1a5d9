"""Quality of the readings: missing ones, noise, clipping and spikes."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gyrowheel_analysis.criteria import MOST_SPIKES, NOISE_RANGE, OUTLIER, SPIKE
from gyrowheel_analysis.reduction.clock import even_times
from gyrowheel_analysis.reduction.samples import Array, Samples
from gyrowheel_core.readings import READINGS, Readings
from gyrowheel_recording.derived import ASSUMED, completed, in_words, origins_in_words
from gyrowheel_sim.bench import Bench

#: Amplitudes of its cosines; Harris, F. J. (1978), Proceedings of the IEEE 66 (1), 51-83.
_BLACKMAN_HARRIS = (0.35875, 0.48829, 0.14128, 0.01168)


def taper(samples: int) -> NDArray[np.float64]:
    """Return the periodic Blackman-Harris window; SciPy's module for it loads longer than a reduction takes."""
    angle = np.linspace(-np.pi, np.pi, samples + 1)
    window = sum((part * np.cos(k * angle) for k, part in enumerate(_BLACKMAN_HARRIS)), np.zeros(samples + 1))
    return window[:-1]


#: Readings that change slowly; the air first, because coils without a sensor are assumed to have its temperature.
_FILLED = ("air_temperature", "air_pressure", "coil_temperature")
#: The same in the order of the message.
SLOW = tuple(name for name in READINGS if name in _FILLED)
#: Readings without which a sample is not used.
NEEDED = tuple(name for name in READINGS if name not in SLOW)
#: Readings from which the white noise of each name in the bench file is estimated.
_NOISE_SHOWN_BY: dict[str, tuple[str, ...]] = {
    "tilt_noise": ("tilt_x", "tilt_y"),
    "spin_angle_noise": ("spin_angle",),
    "spin_rate_noise": ("spin_rate",),
    "coil_voltage_noise": ("coil_voltage_x", "coil_voltage_y"),
    "motor_voltage_noise": ("motor_voltage",),
    "motor_current_noise": ("motor_current",),
}
#: Names of the noise of the readings in the bench file, in the order of `Windows.reading_noise`.
READING_NOISES = tuple(_NOISE_SHOWN_BY)
#: Readings that a sensor clips at the end of its range.
_CLIPPED = ("tilt_x", "tilt_y", "spin_rate", "motor_current")
_FROZEN = 1.0  # K
_NOISE_BLOCKS = (256, 64)  # samples; short blocks where many samples are lost
_MOST_BLOCKS = 400
_FEWEST_BLOCKS = 20
_COMMANDED = 1e-6  # share of the largest spectrum of commands below which nothing was commanded
_NOISE_BAND = (0.4, 0.97)  # of half the sampling rate: above every motion, below the corner of a filter
#: Intervals before and after one whose commands a reading of a coil voltage may show, delayed and filtered.
_SHOWN_COMMANDS = (-7, 2)
_SPIKE_ROUNDS = 12
#: More of them than the first number within the second number of samples are no spikes but something that happened, as
#: the response of the loop to a late command, or a motion at the edge of a window.
_MOST_TOGETHER, _TOGETHER = 3, 10


def readable(data: Samples, bench: Bench) -> tuple[Samples, Array, tuple[str, ...]]:
    """Return a recording in which every reading is a number, the times of dropped samples [s], and assumptions.

    Samples that lack one of `NEEDED` (not finite) are dropped as if they had been lost. Missing temperatures and
    pressures, which change slowly, are interpolated; the bench gives the state of air that was never measured. The
    assumptions are sentences about quantities that were never measured. Complete recordings are returned unchanged.
    """
    data = _without_frozen(data)
    finite = np.isfinite(data.readings.array)
    substituted = origins_in_words(data.origins)
    if finite.all() and not data.summed:
        return data, np.zeros(0), substituted
    if data.summed:
        # an integral of the speed does not show the instants: jitter counts as that of the stamps
        data = replace(data, time=even_times(data.time, data.period(bench.sample_period)))
    readings, assumed = completed(data.time, data.readings, data.absent, bench).copy(), []
    for name in NEEDED:
        if name in data.absent and not np.isfinite(readings[name]).any():
            readings[name][:] = 0.0  # never compared
    finite = np.isfinite(readings.array)
    for name in _FILLED:
        column = readings[name]
        known = np.isfinite(column)
        if known.all():
            continue
        if known.any():
            column[~known] = np.interp(data.time[~known], data.time[known], column[known])
        elif name == "coil_temperature":
            column[:] = readings.air_temperature
            assumed.append(f"coil_temperature (that of the air is taken, ± {ASSUMED[name][1]:g} K)")
        else:
            column[:] = bench.value(name)
            if name == "air_pressure":
                for event in data.environment:
                    column[data.time >= event.time] = bench.value("air_pressure") * event.air_density_ratio
            size = "± {:g} K" if name == "air_temperature" else "± {:g} Pa"
            assumed.append(f"{name} (that of the bench is taken, {size.format(ASSUMED[name][1])})")
    whole = np.asarray(finite[:, Readings.columns(NEEDED)].all(axis=1))
    read = replace(
        data,
        time=data.time[whole],
        readings=readings[whole],
        sequence=None if data.sequence is None else data.sequence[whole],
        commanded=None if data.commanded is None else data.commanded[whole],
    )
    return read, data.time[~whole], (*in_words(data.absent), *substituted, *assumed)


def _without_frozen(data: Samples) -> Samples:
    """Return a recording without temperatures near absolute zero: some loggers write 0 where a sensor gives nothing."""
    frozen = {name: data.readings[name] < _FROZEN for name in ("coil_temperature", "air_temperature")}
    if not any(where.any() for where in frozen.values()):
        return data
    readings = data.readings.copy()
    for name, where in frozen.items():
        readings[name][where] = math.nan
    return replace(data, readings=readings)


def reading_noise(data: Samples, bench: Bench) -> Array:
    """Return the standard deviation of the white noise of the readings of `READING_NOISES` [SI], (6,).

    It is estimated from the upper part of the spectrum, above every motion, by the median, which ignores lines such as
    the motor ripple. In the coil voltages the controller's response to the noise of its readings reaches into that
    band; the part that the commands explain is removed, and without commands the stated noise holds (at other rates
    than the loop's see `samples.loop_period`). The stated noise also holds for all readings if too many samples are
    lost, and for a reading whose spectrum is empty.
    """
    stated = np.array([bench.value(name) for name in READING_NOISES])
    shown = [name for names in _NOISE_SHOWN_BY.values() for name in names]
    coils = [shown.index(name) for name in _NOISE_SHOWN_BY["coil_voltage_noise"]]
    period = data.period(bench.sample_period)
    whole = np.flatnonzero(np.abs(np.diff(data.time) - period) > 0.5 * period) + 1
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
    at = starts[:, None] + np.arange(block)
    values = data.readings.array[at][:, :, Readings.columns(shown)]
    angle = shown.index("spin_angle")
    values[:, :, angle] = np.unwrap(values[:, :, angle], axis=1)
    x = np.linspace(-1.0, 1.0, block)
    basis, _ = np.linalg.qr(x[:, None] ** np.arange(3))
    values = values - basis @ (basis.T @ values)
    window = taper(block)
    low, high = (round(edge * block / 2) for edge in _NOISE_BAND)
    waves = np.fft.rfft(values * window[:, None], axis=1)[:, low:high]
    if data.commanded is None:
        waves[:, :, coils] = 0.0
    else:
        lags = np.arange(*_SHOWN_COMMANDS)
        around = np.clip(at[:, :, None] + lags, 0, len(data.commanded) - 1)
        for axis, column in enumerate(coils):
            commands = np.fft.rfft(data.commanded.at(around, axis) * window[:, None], axis=1)[:, low:high]
            waves[:, :, column] = _not_commanded(waves[:, :, column], commands)
    power = np.abs(waves) ** 2 / np.sum(window**2)
    level = np.median(np.median(power, axis=1), axis=0) / math.log(2.0)
    found = []
    for names in _NOISE_SHOWN_BY.values():
        taken = [level[shown.index(name)] for name in names if name not in data.absent]
        found.append(math.sqrt(float(np.mean(taken))) if taken else 0.0)
    return np.array(
        [
            own if ratio == 0.0 else own * min(max(ratio, NOISE_RANGE[0]), NOISE_RANGE[1])
            for own, ratio in zip(stated, np.array(found) / stated, strict=True)
        ]
    )


def _not_commanded(waves: Any, commands: Any) -> Any:
    """Return spectra of a voltage (blocks, n) without the part that commands of neighbouring intervals explain.

    One filter of the `commands` (blocks, n, lags) serves all blocks; each has the same weight, whatever its size.
    """
    size = np.sqrt(np.mean(np.abs(commands) ** 2, axis=(1, 2)))
    # without commands, as before the controller starts, there are only rounding errors: they must not count
    size = np.maximum(size, _COMMANDED * np.max(size, initial=0.0)) + (not size.any())
    design = (commands / size[:, None, None]).reshape(-1, commands.shape[2])
    target = (waves / size[:, None]).ravel()
    normal = (design.conj().T @ design).real
    filtered = np.linalg.lstsq(normal, (design.conj().T @ target).real, rcond=1e-10)[0]
    return waves - commands @ filtered


def clipped_readings(data: Samples) -> NDArray[np.bool_]:
    """Return where a reading of tilt, speed or current is clipped: it stays at the end of its range."""
    result = np.zeros(len(data.time), dtype=bool)
    if not len(data.time):
        return result
    for name in _CLIPPED:
        values = data.readings[name]
        for end in (values.min(), values.max()):
            at = values == end
            # a noisy reading reaches its extreme once; one without noise may stay at any value
            if at.sum() > 20 and not _quantised(values):
                result |= at
    return result


def _quantised(values: Array) -> bool:
    """Whether a reading takes so few values that it reaches its extreme often without being clipped."""
    some = values[:: max(len(values) // 5000, 1)]
    return len(np.unique(some)) < 0.2 * len(some)


def despiked(
    readings: Any, design: Array, gram: Array, commanded: Mapping[int, Any] | None = None
) -> tuple[Any, Any, Any]:
    """Fit columns of readings (n, columns), real or complex, robustly against spikes.

    `design` (n, terms) has the terms that are fitted to each column, `gram` is the inverse of ``design.T @ design``.
    `commanded` are the commands (n,) of some columns, by number: a reading that follows its command is no spike, but
    the response of the loop to noise in another reading. Returns the readings with each isolated spike replaced by the
    value of the fit to all others, the coefficients (columns, terms), and the residuals (n, columns).
    """
    pseudo, as_read = gram @ design.T, readings
    fit, left = _fitted(readings, design, pseudo)
    found = np.zeros(readings.shape, dtype=bool)
    crowd = found.copy()
    for k, command in (commanded or {}).items():
        size, off = np.abs(left[:, k]), np.abs(readings[:, k] - command)
        crowd[:, k] = (size > OUTLIER * _scale(left)[k]) & (off < 0.5 * size)
    # a spike pulls the fit and hides smaller spikes until it is removed
    for _ in range(_SPIKE_ROUNDS):
        more = _spikes(left) & ~found & ~crowd
        more &= (found | more).mean(axis=0) <= MOST_SPIKES
        if not more.any():
            break
        found, changed = found | more, more.any(axis=0)
        if (together := _crowded(found | crowd) & ~crowd).any():
            # they seemed to be spikes while only the largest of them stood out
            crowd, found = crowd | together, found & ~together
            changed |= together.any(axis=0)
            readings = np.where(changed, as_read, readings)
            left = _fitted(readings, design, pseudo)[1]
        readings = readings.copy()
        for column in np.flatnonzero(changed):
            rows = np.flatnonzero(found[:, column])
            own = design[rows]
            pulled = np.eye(len(rows)) - own @ gram @ own.T
            readings[rows, column] -= np.linalg.lstsq(pulled, left[rows, column], rcond=None)[0]
        fit, left = _fitted(readings, design, pseudo)
    return readings, fit, left


def _fitted(readings: Any, design: Array, pseudo: Array) -> tuple[Any, Any]:
    """Return the coefficients (columns, terms) and the residuals of a fit; complex readings as pairs of real ones."""
    numbers = np.ascontiguousarray(readings).view(np.float64)
    fit = pseudo @ numbers
    left = numbers - design @ fit
    return np.ascontiguousarray(fit).view(readings.dtype).T, left.view(readings.dtype)


def _spikes(left: Any) -> NDArray[np.bool_]:
    """Return which residuals (n, columns) are isolated and far above the others; columns with many such have none."""
    size = np.abs(left)
    # where half of them are above the largest over `SPIKE`, none is far above their median, which takes long to find
    largest = size.max(axis=0, initial=0.0)
    if (2 * np.count_nonzero(size > _medians(left) / SPIKE * largest, axis=0) > len(size)).all():
        return np.zeros(size.shape, dtype=bool)
    scale = _scale(left)
    # relative to the largest one too: it pulls the fit, so that its neighbours seem far off
    far = size > np.maximum(SPIKE * scale, 0.3 * largest)
    return np.asarray(far & (far.mean(axis=0) <= MOST_SPIKES) & (scale > 0.0))


def _scale(left: Any) -> Array:
    """Return the robust standard deviation of residuals (n, columns), of each part of complex ones."""
    return np.asarray(np.median(np.abs(left), axis=0) / _medians(left))


def _medians(left: Any) -> Any:
    """Return the median of the absolute value of Gaussian residuals over their standard deviation, by column."""
    return np.where(np.any(left.imag, axis=0), 1.1774, 0.6745) if np.iscomplexobj(left) else 0.6745


def _crowded(found: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return which of some samples (n, columns) have many others near them."""
    total = np.cumsum(np.pad(found, ((_TOGETHER + 1, _TOGETHER), (0, 0))), axis=0)
    return np.asarray(found & (total[2 * _TOGETHER + 1 :] - total[: -2 * _TOGETHER - 1] > _MOST_TOGETHER))


def without_spikes(values: Array) -> Array:
    """Return slow readings (n, columns) with their spikes replaced by the median."""
    middle = np.median(values, axis=0)
    return np.where(_spikes(values - middle), middle, values)
