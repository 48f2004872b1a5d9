"""Hum of the mains in the readings: lines that stay at one frequency at every speed of the rotor.

They are sought in steady windows, at the frequency of the mains and its harmonics, against the level of the spectrum
around them. Near a multiple of the spin speed hum cannot be distinguished from the rotor.

A hum of the tilt readings goes round the tilt loop: the coils answer it and turn the rotor. The commands, and the
rotor's response to them, are subtracted, so that the rest is in the readings alone.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammainccinv

from gyrowheel_analysis.criteria import CLEAR_HUM, HUM_CHANCE, HUM_LEVEL
from gyrowheel_analysis.reduction.quality import taper
from gyrowheel_analysis.reduction.samples import Samples
from gyrowheel_analysis.reduction.windows import FORWARD, Windows
from gyrowheel_sim.bench import Bench
from gyrowheel_sim.instruments import held_response, smooth_response

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
_PAIRS = tuple(zip(CHANNELS["coil_voltage"], COMMANDED, strict=True))
_MOST_WINDOWS = 40
SHORTEST = 0.7  # s
FEWEST = 4  # windows
#: Half the width of a line after the taper, over 1/length.
MAIN_LOBE = 4.0
_ROTOR_ORDERS = np.arange(1, 13)  # multiples of the spin speed at which a line may be the rotor's


@dataclass(frozen=True)
class Spectra:
    """Tapered windows and their spectra.

    `values` are the tapered readings (n, columns) of each window less their mean, scaled so that the sum over
    exp(-i w t) is the amplitude of a line; `power` (windows, bins, columns) are squares of the amplitudes at the
    frequencies `grid` [Hz]; `spin` [turns/s] and `length` [s] belong to the windows.
    """

    values: list[Array]
    power: Array
    grid: Array
    spin: Array
    length: Array
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

    `period` is the sampling period [s], `highest` the highest frequency of interest [Hz].
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
    # one grid for all: a window is padded with zeros
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
        period,
        columns,
    )


def rotor_gap(spin: Array, frequencies: Array) -> Array:
    """Return the distance of frequencies [Hz] from the next multiple of spin speeds [turns/s] (speeds, frequencies)."""
    turns = spin[:, None, None] * _ROTOR_ORDERS
    gap: Array = np.abs(frequencies[None, :, None] - turns).min(axis=2)
    return gap


_MOTION_KNOWN = 0.05  # relative uncertainty of the rotor's response: constants, and instants of the readings
_STIFF = 0.15  # of the gyroscopic torque: below it the rotor resonates, and its response is unknown
#: Distances from a line at which the response of the readings is measured, over 1/length.
_BESIDE = (5.0, 6.5, 8.0, 9.5, 11.0)


def line_amplitudes(
    spectra: Spectra, chosen: NDArray[np.bool_], frequency: float, level: Array, bench: Bench
) -> dict[str, tuple[float, float]]:
    """Return the amplitude of a line in the readings of every channel, with its standard error."""
    lines = spectra.at(frequency, chosen)
    at = {name: lines[:, k] for k, name in enumerate(spectra.columns)}
    noise = {name: level[:, k] for k, name in enumerate(spectra.columns)}
    result = {name: _mean_size([at[name]], [noise[name]]) for name in ("motor_voltage", "motor_current")}
    spin = 2.0 * math.pi * spectra.spin[chosen]
    known = spectra.columns[-1] == COMMANDED[-1]
    if known:
        # the readings' response to the commands, from the frequencies around, where there is no hum
        length = float(np.median(spectra.length))
        beside = [frequency + sign * d / length for sign in (-1.0, 1.0) for d in _BESIDE]
        sums = np.zeros(2, dtype=complex)
        around = {f: spectra.at(f, chosen) for f in beside}
        pairs = [(spectra.columns.index(r), spectra.columns.index(c)) for r, c in _PAIRS]
        for rows in around.values():
            for r, c in pairs:
                sums += (np.vdot(rows[:, c], rows[:, r]), np.vdot(rows[:, c], rows[:, c]))
        gain = sums[0] / sums[1] if abs(sums[1]) > 0.0 else 1.0
        left = [at[r] - gain * at[c] for r, c in _PAIRS]
        rest = [np.abs(rows[:, r] - gain * rows[:, c]) ** 2 for rows in around.values() for r, c in pairs]
        scatter = math.sqrt(np.mean([np.mean(square) for square in rest]))
        size, error = _mean_size(left, [np.full(len(left[0]), scatter)] * 2)
        gain_error = scatter / math.sqrt(abs(sums[1]))
        commanded = math.sqrt(float(np.mean([np.mean(np.abs(at[c]) ** 2) for _, c in _PAIRS])))
        result["coil_voltage"] = (size, math.hypot(error, math.sqrt(0.5) * gain_error * commanded))
    # the tilt, without the rotor's response to the coils
    drive = [at[c if known else r] for r, c in _PAIRS]
    held = min(bench.sample_period, spectra.period)
    forward, backward = _turned(at["tilt_x"], at["tilt_y"])
    moved, resists = [], []
    for amplitude, sign in zip(_turned(*drive), (1.0, -1.0), strict=True):
        omega = sign * 2.0 * math.pi * frequency
        answer, clear = _answer(amplitude, omega, spin, bench, held, commanded=known)
        moved.append(answer)
        resists.append(clear)
    clear = resists[0] & resists[1]
    if clear.sum() >= FEWEST:
        left = [(forward - moved[0])[clear], (backward - moved[1])[clear]]
        own = np.sqrt(0.5 * (noise["tilt_x"] ** 2 + noise["tilt_y"] ** 2))[clear] / math.sqrt(2.0)
        size, error = _mean_size(left, [own, own])
        motion = math.sqrt(float(np.mean([np.mean(np.abs(m[clear]) ** 2) for m in moved])))
        # from amplitudes forward and backward to that of one axis
        result["tilt"] = (math.sqrt(2.0) * size, math.sqrt(2.0) * math.hypot(error, _MOTION_KNOWN * motion))
    return result


def _turned(x: Complex, y: Complex) -> tuple[Complex, Complex]:
    """Return the amplitudes of exp(i w t) and exp(-i w t) in x + i y, from twice those of exp(i w t) in x and y."""
    return 0.5 * (x + 1j * y), 0.5 * (np.conj(x) + 1j * np.conj(y))


def _answer(
    voltage: Complex, omega: float, spin: Array, bench: Bench, held: float, *, commanded: bool
) -> tuple[Complex, NDArray[np.bool_]]:
    """Return the rotor's response to the coils in the tilt readings, and where it is known.

    `voltage` is the amplitude of exp(i omega t) in the voltages x + i y, as read or as commanded for the interval that
    ends at the stamp and lasts `held` [s].
    """
    v, half = bench.value, 0.5 * omega * held
    acting = voltage * np.exp(1j * half) * np.sinc(half / math.pi)
    if not commanded:
        acting = acting / held_response(omega, *_chain(bench, "coil_voltage"), period=held)
    inertia = bench.transverse_inertia
    stiffness = bench.flexure_stiffness
    gyro = bench.precession_inertia * spin * omega
    resistance = stiffness + gyro - inertia * omega**2
    clear = np.abs(resistance) > _STIFF * np.abs(gyro)
    moved = v("coil_constant") * acting / np.where(clear, resistance, np.inf)
    return moved * smooth_response(omega, *_chain(bench, "tilt")), clear


def _chain(bench: Bench, channel: str) -> tuple[float, float, int]:
    v = bench.value
    return v(f"{channel}_delay"), v(f"{channel}_filter_time"), round(v(f"{channel}_filter_order"))


def _mean_size(lines: list[Complex], noise: list[Array]) -> tuple[float, float]:
    """Return the root mean square amplitude of lines less the contribution of noise, and its standard error."""
    square = float(np.mean([np.mean(np.abs(line) ** 2) for line in lines]))
    own = float(np.mean([np.mean(n**2) for n in noise]))
    count = sum(len(line) for line in lines)
    size = math.sqrt(max(square - own, 0.0))
    # each amplitude has the noise `own`, half of it along the line
    spread = math.sqrt((2.0 * own * size**2 + own**2) / count)
    return size, spread / (2.0 * size) if size**2 > 0.5 * spread else math.sqrt(spread)


#: Frequencies of mains [Hz], and their multiples that are searched.
MAINS = (50.0, 60.0)
MULTIPLES = (1, 2, 3)
_AROUND = 12.0  # over 1/length: range in which the level around a line is measured
_WANDERS = 0.012  # part by which the frequency of a mains may be off
#: Share of a hum in the amplitude of a window from which on it is the same in all windows of a speed.
_SEEN = 0.3


@dataclass(frozen=True)
class Line:
    """A line that stays at one frequency.

    It is the `multiple` of the nominal frequency `mains` [Hz], at `frequency` with a standard error [Hz]. `amplitudes`
    has the amplitude in the readings of every channel, and its standard error [SI]; a channel in which it cannot be
    measured is missing. `found` are the channels in which it stands above the noise.
    """

    mains: float
    multiple: int
    frequency: float
    frequency_error: float
    amplitudes: Mapping[str, tuple[float, float]]
    found: frozenset[str] = field(default_factory=frozenset)


def find_lines(data: Samples, windows: Windows, bench: Bench) -> list[Line]:
    """Look for hum in the steady windows of a recording at the mains frequencies that the bench states and usual ones.

    There is one line for every multiple of a mains frequency at which hum was found, and for the stated frequency in
    any case where its presence can be decided.
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
    """Return the line at a multiple of a mains frequency; None if it cannot be measured.

    Where nothing is found, amplitudes and their errors are computed only on demand.
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
        warnings.simplefilter("ignore", RuntimeWarning)  # a window without values
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
    # the response of the loop alone is no hum of the reading
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
    """Return the variance that hum adds to the amplitudes of exp(i h theta) in tilt [rad²] and coil voltages [V²].

    The result is (n, 2, orders), for the orders `FORWARD`. Hum that is nearly the same in several windows counts as
    many times, so that their mean is not known better than one of them.
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
                    # both axes have the same hum: half of |1 + i|² of the square turns forward
                    result[:, column, k] += 0.5 * (line.amplitudes[channel][0] * share) ** 2 * times
    return result


def unobservable(windows: Windows, mains: float) -> str:
    """Return why the presence of hum of a mains frequency cannot be decided; empty if it can.

    ``rotor``: it is at a multiple of the speed in all windows; ``short``: there are too few whole windows.
    """
    long = windows.duration >= SHORTEST
    if np.count_nonzero(long & ~windows.moving) < FEWEST:
        return "short"
    gap = rotor_gap(windows.mean_spin / (2.0 * math.pi), np.array([mains]))[:, 0]
    return "" if np.count_nonzero(long & (gap > (MAIN_LOBE + 1.0) / windows.duration)) >= FEWEST else "rotor"
