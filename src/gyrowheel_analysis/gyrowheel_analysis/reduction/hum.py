"""Hum of the mains in the readings: lines that stay at one frequency whatever the speed of the rotor.

They are looked for in steady windows, at the frequency of the mains and its harmonics, beside the level of the spectrum
around them. Where a multiple of the spin speed is near, nothing can be told.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from scipy.special import gammainccinv

from gyrowheel_analysis.criteria import CLEAR_HUM, HUM_CHANCE, HUM_LEVEL
from gyrowheel_analysis.reduction.hum_amplitude import line_amplitudes
from gyrowheel_analysis.reduction.samples import Samples
from gyrowheel_analysis.reduction.spectra import (
    CHANNELS,
    FEWEST,
    MAIN_LOBE,
    SHORTEST,
    Array,
    Spectra,
    rotor_gap,
    tapered,
)
from gyrowheel_analysis.reduction.windows import FORWARD, Windows
from gyrowheel_sim.bench import Bench

#: Frequencies of mains [Hz], and the multiples of them that are looked at.
MAINS = (50.0, 60.0)
MULTIPLES = (1, 2, 3)
_AROUND = 12.0  # over 1/length: how far the level around a line is looked at
_WANDERS = 0.012  # part by which the frequency of a mains may be off
_SEEN = (
    0.3  # share of a hum in the amplitude of a window from which on it is the same in all windows of a speed
)


@dataclass(frozen=True)
class Line:
    """A line that stays at one frequency.

    Attributes
    ----------
    mains, multiple : float, int
        Nominal frequency of the mains [Hz], and which multiple of it this is.
    frequency, frequency_error : float
        Where it is [Hz].
    amplitudes : dict of str to (float, float)
        Amplitude in the readings of every channel, and its standard error [SI]. A channel in which it cannot be told
        is missing.
    found : frozenset of str
        Channels in which it stands above the noise.
    """

    mains: float
    multiple: int
    frequency: float
    frequency_error: float
    amplitudes: Mapping[str, tuple[float, float]]
    found: frozenset[str] = field(default_factory=frozenset)


def find_lines(data: Samples, windows: Windows, bench: Bench) -> list[Line]:
    """Look for hum at the mains frequencies that the bench states and that are usual.

    Parameters
    ----------
    data : Samples
        The recording.
    windows : Windows
        Its steady windows.
    bench : Bench
        The bench as stated.

    Returns
    -------
    list of Line
        One for every multiple of a mains frequency at which hum was found, and for the stated frequency in any case
        where it can be told whether there is any.
    """
    stated = bench.value("mains_frequency")
    highest = 1.05 * max(MULTIPLES) * max(stated, *MAINS)
    spectra = tapered(data, windows, data.period(bench.sample_period), highest)
    if spectra is None:
        return []
    found = []
    for mains in dict.fromkeys((stated, *(f for f in MAINS if abs(f / stated - 1.0) > _WANDERS))):
        for multiple in MULTIPLES:
            asked = mains == stated and multiple == 1
            line = _line(spectra, mains, multiple, bench, asked=asked)
            if line is not None and (line.found or asked):
                found.append(line)
    return found


def _line(spectra: Spectra, mains: float, multiple: int, bench: Bench, *, asked: bool) -> Line | None:
    """Return what there is at a multiple of a mains frequency; None if it cannot be told.

    Where nothing is found, amplitudes and their errors are computed only if they are asked for.
    """
    nominal = mains * multiple
    length = float(np.median(spectra.length))
    reach = max(_WANDERS * nominal, 1.0 / length)
    if nominal + reach + _AROUND / length > spectra.grid[-1]:
        return None
    apart = spectra.apart(nominal, MAIN_LOBE + reach * length)
    if apart.sum() < FEWEST:
        return None
    power, grid = spectra.power[apart], spectra.grid
    off = np.abs(grid - nominal)
    # the level around, where no multiple of the speed is
    beside = (off > reach + MAIN_LOBE / length) & (off < reach + _AROUND / length)
    gap = rotor_gap(spectra.spin[apart], grid[beside])
    rotor = gap < MAIN_LOBE / spectra.length[apart][:, None]
    around = np.where(rotor[:, :, None], np.nan, power[:, beside])
    with np.errstate(invalid="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # a window in which nothing is left
        level = _typical(around)
    count = np.isfinite(level).all(axis=1)
    if count.sum() < FEWEST:
        return None
    near = np.flatnonzero(off <= reach)
    found, best = set(), (0.0, nominal)
    for channel, names in CHANNELS.items():
        own = [spectra.columns.index(name) for name in names]
        relative = power[count][:, :, own] / np.where(level > 0.0, level, np.inf)[count][:, None, own]
        ratio = relative[:, near].mean(axis=(0, 2))
        k = int(np.argmax(ratio))
        shape = int(count.sum()) * len(own)
        limit = HUM_LEVEL * float(gammainccinv(shape, HUM_CHANCE)) / shape
        if ratio[k] > limit:
            found.add(channel)
            if ratio[k] > best[0]:
                best = (float(ratio[k]), _peak(grid, relative.mean(axis=(0, 2)), int(near[k])))
    if not (found or asked):
        return None
    frequency = best[1]
    use = np.flatnonzero(apart)[count]
    chosen = np.zeros(len(apart), dtype=bool)
    chosen[use] = True
    amplitudes = line_amplitudes(spectra, chosen, frequency, np.sqrt(level[count]), bench)
    # what is the answer of the loop, and nothing else, is no hum of the reading
    found = {c for c in found if c in amplitudes and amplitudes[c][0] > CLEAR_HUM * amplitudes[c][1]}
    snr = max(best[0] - 1.0, 1e-3) * int(count.sum())
    error = math.sqrt(6.0) / (math.pi * length * math.sqrt(snr))
    return Line(mains, multiple, frequency, error, amplitudes, frozenset(found))


def _typical(around: Array) -> Array:
    """Return the mean square of noise (windows, columns) from its median, which lines do not move."""
    result: Array = np.nanmedian(around, axis=1) / math.log(2.0)
    return result


def _peak(grid: Array, power: Array, k: int) -> float:
    """Return where a line is, by the parabola through the logarithms of three values."""
    if not 0 < k < len(grid) - 1:
        return float(grid[k])
    a, b, c = np.log(power[k - 1 : k + 2])
    bend = a - 2.0 * b + c
    shift = 0.5 * (a - c) / bend if bend < 0.0 else 0.0
    return float(grid[k] + min(max(shift, -0.5), 0.5) * (grid[1] - grid[0]))


def hum_variance(lines: list[Line], windows: Windows) -> Array:
    """Return the variance that hum adds to the amplitudes of exp(i h theta) in tilt and coil voltages.

    Parameters
    ----------
    lines : list of Line
        The lines that were found.
    windows : Windows
        The windows.

    Returns
    -------
    ndarray (n, 2, orders)
        In the tilt [rad²] and the coil voltages [V²], for the orders `FORWARD`. What is nearly the same in several
        windows counts as many times, so that their mean is not known better than one of them.
    """
    result = np.zeros((len(windows), 2, len(FORWARD)))
    for line in lines:
        for k, order in enumerate(FORWARD):
            off = np.abs(line.frequency - order * windows.mean_spin / (2.0 * math.pi)) * windows.duration
            share = np.minimum(1.0, 1.0 / (math.pi * np.maximum(off, 1e-9)))
            alike = share > _SEEN
            times = np.where(alike, float(np.count_nonzero(alike)), 1.0)
            for column, channel in enumerate(("tilt", "coil_voltage")):
                if channel in line.found:
                    # both axes have it alike: half of |1 + i|² of the square turns forward
                    result[:, column, k] += 0.5 * (line.amplitudes[channel][0] * share) ** 2 * times
    return result


def untold(windows: Windows, mains: float) -> str:
    """Return why it cannot be told whether there is hum of a mains frequency, empty if it can.

    Returns
    -------
    str
        ``rotor``: it is at a multiple of the speed in all windows; ``short``: there are too few whole windows.
    """
    long = windows.duration >= SHORTEST
    if np.count_nonzero(long & ~windows.moving) < FEWEST:
        return "short"
    gap = rotor_gap(windows.mean_spin / (2.0 * math.pi), np.array([mains]))[:, 0]
    return "" if np.count_nonzero(long & (gap > (MAIN_LOBE + 1.0) / windows.duration)) >= FEWEST else "rotor"
