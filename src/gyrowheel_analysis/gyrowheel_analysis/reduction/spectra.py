"""Spectra of the readings in steady windows, and the lines in them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gyrowheel_analysis.reduction.quality import taper
from gyrowheel_analysis.reduction.samples import Samples
from gyrowheel_analysis.reduction.windows import Windows

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Channels in which hum is looked for, each with its readings.
CHANNELS: Mapping[str, tuple[str, ...]] = {
    "tilt": ("tilt_x", "tilt_y"),
    "coil_voltage": ("coil_voltage_x", "coil_voltage_y"),
    "motor_voltage": ("motor_voltage",),
    "motor_current": ("motor_current",),
}
_READ = tuple(name for names in CHANNELS.values() for name in names)
#: Commands to the coils, as further columns next to the readings.
COMMANDED = ("command_x", "command_y")
_MOST_WINDOWS = 40
SHORTEST = 0.7  # s
FEWEST = 4  # windows
#: Half the width of what the taper makes of a line, over 1/length.
MAIN_LOBE = 4.0
_ROTOR_ORDERS = np.arange(1, 13)  # multiples of the spin speed at which a line may be the rotor's


@dataclass(frozen=True)
class Spectra:
    """Tapered windows and their spectra.

    Attributes
    ----------
    values : list of ndarray (n, columns)
        Tapered readings less their mean, scaled so that the sum over exp(-i w t) is the amplitude of a line.
    power : ndarray (windows, bins, columns)
        Squares of the amplitudes at the frequencies `grid`.
    spin : ndarray (windows,)
        Turns in a second.
    length : ndarray (windows,)
        Length [s].
    """

    values: list[Array]
    power: Array
    grid: Array
    spin: Array
    length: Array
    start: Array
    period: float
    columns: tuple[str, ...]

    def apart(self, frequency: float, width: float) -> NDArray[np.bool_]:
        """Return the windows in which no multiple of the spin speed is within `width` / length of a frequency."""
        return np.asarray(rotor_gap(self.spin, np.array([frequency]))[:, 0] > width / self.length)

    def at(self, frequency: float, windows: NDArray[np.bool_]) -> Complex:
        """Return the amplitudes of exp(i w t) times two, (windows, columns)."""
        own = [self.values[k] for k in np.flatnonzero(windows)]
        longest = max((len(values) for values in own), default=0)
        phase = np.exp(-2j * math.pi * frequency * self.period * np.arange(longest))
        return np.array([phase[: len(values)] @ values for values in own])


def tapered(data: Samples, windows: Windows, period: float, highest: float) -> Spectra | None:
    """Return the spectra of windows that lack no sample, spread over a recording; None if there are too few.

    Parameters
    ----------
    data : Samples
        The recording.
    windows : Windows
        Its steady windows.
    period : float
        Sampling period [s].
    highest : float
        Highest frequency that is looked at [Hz].
    """
    whole = np.flatnonzero(
        (windows.duration >= SHORTEST)
        & (np.abs(windows.samples - windows.duration / period) < 1.5)
        & ~windows.moving
    )
    if len(whole) < FEWEST:
        return None
    whole = whole[np.linspace(0, len(whole) - 1, min(len(whole), _MOST_WINDOWS)).astype(np.int64)]
    columns = _READ if data.commanded is None else (*_READ, *COMMANDED)
    # one grid for all: a window is filled up with zeros
    size = 2 ** math.ceil(math.log2(float(windows.samples[whole].max()) * 2.0))
    grid: Array = np.asarray(np.fft.rfftfreq(size, period), dtype=np.float64)
    top = int(np.searchsorted(grid, highest))
    values, power, tapers = [], [], {}
    for k in whole:
        first = int(np.searchsorted(data.time, windows.start[k] + 0.5 * period))
        own = slice(first, first + int(windows.samples[k]))
        n = own.stop - own.start
        rows = np.column_stack([data.readings[name][own] for name in _READ])
        if data.commanded is not None:
            rows = np.column_stack([rows, *(data.commanded.at(own, axis) for axis in (0, 1))])
        if n not in tapers:
            window = taper(n)
            tapers[n] = (2.0 * window / window.sum())[:, None]
        rows = (rows - rows.mean(axis=0)) * tapers[n]
        values.append(rows)
        power.append(np.abs(np.fft.rfft(rows, size, axis=0)[:top]) ** 2)
    return Spectra(
        values,
        np.array(power),
        grid[:top],
        windows.mean_spin[whole] / (2.0 * math.pi),
        windows.duration[whole],
        windows.start[whole],
        period,
        columns,
    )


def rotor_gap(spin: Array, frequencies: Array) -> Array:
    """Return the distance of frequencies [Hz] from the next multiple of spin speeds [turns/s] (speeds, frequencies)."""
    turns = spin[:, None, None] * _ROTOR_ORDERS
    gap: Array = np.abs(frequencies[None, :, None] - turns).min(axis=2)
    return gap
