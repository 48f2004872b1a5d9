"""The motion within a window that is below the noise of the tilt readings, from the torque of the coils that causes it.

The loop answers the noise of its readings, so that the rotor moves by some microradians at all frequencies. The tilt
readings do not show this motion, but the torque of the coils does, which exceeds its noise by far: the rotor answers it
as a free gyroscope. Laws that count every movement, say the friction of a cable, need it.
"""

from __future__ import annotations

import math

import numpy as np

from gyrowheel_analysis.reduction.samples import Array, Samples
from gyrowheel_analysis.reduction.windows import DEGREE, MODULATION, Windows, speed_groups, waves_of
from gyrowheel_sim.bench import Bench

_SHORTEST = 0.4  # s, of a window: a shorter one does not resolve the frequencies about that of the nutation
#: Distances [Hz] from the nutation: within the first, torque over motion depends on an inertia that is known to a
#: part in a hundred; up to the second, motion is about as strong there.
_NEAR, _AROUND = 3.0, 9.0


def unseen_rates(windows: Windows, bench: Bench, data: Samples) -> tuple[Array, Array]:
    """Return spin rates [rad/s], ascending, and at each the deviation of each axis of the unseen tilt rate [rad/s].

    Both are empty where no window is long enough.
    """
    spin, variance = [], []
    for number in np.flatnonzero(windows.duration >= _SHORTEST).tolist():
        if (found := _variance(windows, number, bench, data)) is not None:
            spin.append(float(windows.mean_spin[number]))
            variance.append(found)
    groups = speed_groups(spin)
    rates, levels = np.array(spin), np.array(variance)
    return (
        np.array([float(np.mean(rates[own])) for own in groups]),
        np.sqrt([0.5 * max(float(np.median(levels[own])), 0.0) for own in groups]),
    )


def _variance(windows: Windows, number: int, bench: Bench, data: Samples) -> float | None:
    """Return the mean square of the unseen tilt rate in a window [rad²/s²]; None where the samples do not show it."""
    start, duration = float(windows.start[number]), float(windows.duration[number])
    first, stop = np.searchsorted(data.time, (start, start + duration))
    h = data.period(bench.sample_period)
    inertia = bench.transverse_inertia
    nutation = bench.precession_inertia * float(windows.mean_spin[number]) / inertia
    count = round(duration / h)
    if stop - first < 0.5 * count or nutation * h > 0.5 * math.pi:
        return None
    x = 2.0 * (data.time[first:stop] - start) / duration - 1.0
    angle = data.readings.spin_angle[first:stop]
    waves = waves_of(angle, np.vander(x, MODULATION))
    design = np.hstack([np.polynomial.legendre.legvander(x, DEGREE), waves])
    volts = data.readings.coil_voltage_x[first:stop] + 1j * data.readings.coil_voltage_y[first:stop]
    left = volts - design @ np.linalg.solve(design.T @ design, design.T @ volts)
    even = np.zeros(count, dtype=complex)  # a lost sample adds nothing
    place = np.round((data.time[first:stop] - data.time[first]) / h).astype(int)
    even[np.minimum(place, count - 1)] = left
    share = (stop - first) / count
    noise = float(windows.noise("coil_voltage_noise")[number])
    torque = bench.value("coil_constant") ** 2 * (
        np.abs(np.fft.fft(even)) ** 2 / count / share - 2.0 * noise**2
    )
    frequency = 2.0 * math.pi * np.fft.fftfreq(count, h)
    away = np.abs(frequency - nutation) / (2.0 * math.pi)
    near, around = away < _NEAR, (away >= _NEAR) & (away < _AROUND)
    # of a free gyroscope at the sampling instants, for a torque that is held between them
    answer = math.sin(0.5 * nutation * h) / (
        nutation * inertia * np.sin(0.5 * (frequency - nutation) * h + near)
    )
    power = np.where(near, 0.0, torque * answer**2)
    power[near] = power[around].mean()
    return float(power.mean())


def spread(first: int, last: int) -> Array:
    """Return complex numbers that are distributed as a normal motion, each axis of unit deviation, by their number.

    They fill the plane evenly (Roberts' sequence), so that any sum of them stays small, and any mean is soon exact.
    """
    k = np.arange(first, last, dtype=float)
    size = np.sqrt(-2.0 * np.log1p(-np.mod(0.5 + 0.7548776662466927 * k, 1.0)))
    return np.asarray(size * np.exp(2j * math.pi * np.mod(0.5698402909980532 * k, 1.0)))
