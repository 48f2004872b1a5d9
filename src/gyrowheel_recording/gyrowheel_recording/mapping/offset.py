"""The offset between the clocks of two loggers, by the correlation of what both of them show."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from gyrowheel_core.errors import InputError
from gyrowheel_core.units import conversion
from gyrowheel_recording.tables import Grid
from gyrowheel_sim.bench import Bench

Array = NDArray[np.float64]

#: A motion and what drives it: the rate of the one follows the other, as the laws of the wheel say.
_DRIVEN: Final = (
    ("spin_rate", "motor_current"),
    ("tilt_x", "coil_voltage_y"),
    ("tilt_y", "coil_voltage_x"),
    ("tilt_x", "coil_current_y"),
    ("tilt_y", "coil_current_x"),
)
_STEP: Final = 2e-3  # s
_FARTHEST: Final = 60.0  # s
_LEAST: Final = 0.5  # correlation


def clock_offset(
    found: Mapping[str, Any], grid: Grid, clock: str, bench: Bench
) -> tuple[float, float] | None:
    """Return what must be added to the times of a clock to be those of the map's, and its standard error [s].

    Parameters
    ----------
    found : mapping of str to Proposal
        What the columns are.
    grid : Grid
        The table.
    clock : str
        Column with the times of the other clock.
    bench : Bench
        The bench.

    Returns
    -------
    (float, float) or None
        None where no pair of readings on the two clocks is alike.
    """
    best: tuple[float, float, float] | None = None
    for pair in _DRIVEN:
        if not all(name in found for name in pair):
            continue
        sides = {bool(found[name].clock == clock): name for name in pair}
        if len(sides) != 2 or found[sides[False]].clock:
            continue
        there, here = (_series(found, grid, sides[side]) for side in (True, False))
        if there is None or here is None:
            continue
        match = _match(here, there, moves=sides[False] == pair[0])
        if match is not None and (best is None or match[2] > best[2]):
            best = match
    return None if best is None or best[2] < _LEAST else (best[0], best[1])


def _series(found: Mapping[str, Any], grid: Grid, name: str) -> tuple[Array, Array] | None:
    own, main = found[name], found["time"]
    raw, first = (grid.columns[column].values for column in (own.clock or main.column, main.column))
    if raw.dtype.kind == "M" and first.dtype.kind == "M":
        times = (raw - first[0]).astype("timedelta64[ns]").astype(np.float64) * 1e-9
    else:
        try:
            factor = conversion(main.unit, "s")[1]
        except InputError:
            return None
        times = np.asarray(raw, dtype=np.float64) * factor
    values = np.asarray(grid.columns[own.column].values, dtype=np.float64)
    known = np.isfinite(values) & np.isfinite(times)
    return (times[known], values[known]) if known.sum() > 100 else None


def _match(
    here: tuple[Array, Array], there: tuple[Array, Array], *, moves: bool
) -> tuple[float, float, float] | None:
    """Return the offset at which two series resemble each other most, its error, and their correlation there.

    `moves` is whether the first one is the motion, whose rate counts.
    """
    begin, end = min(here[0][0], there[0][0]), max(here[0][-1], there[0][-1])
    if not 500 <= (end - begin) / _STEP <= 4_000_000:  # two epochs may be decades apart
        return None
    grid = np.arange(begin, end, _STEP)
    one, other = _smoothed(grid, *here, rate=moves), _smoothed(grid, *there, rate=not moves)
    size = 1 << (2 * len(grid) - 1).bit_length()
    product = np.fft.irfft(np.fft.rfft(one, size) * np.conj(np.fft.rfft(other, size)), size)
    most = min(round(_FARTHEST / _STEP), len(grid) - 1)
    lags = np.arange(-most, most + 1)
    sizes = np.abs(product[lags])
    k = int(np.argmax(sizes))
    norm = float(np.linalg.norm(one) * np.linalg.norm(other))
    if not norm or not 0 < k < len(lags) - 1:
        return None
    left, middle, right = sizes[k - 1 : k + 2]
    bend = left - 2.0 * middle + right
    shift = 0.5 * (left - right) / bend if bend < 0.0 else 0.0
    correlation = float(middle) / norm
    # the curvature of the peak against what is not alike
    noise = np.sqrt(max(1.0 - correlation**2, 1e-12)) * norm / np.sqrt(len(grid))
    error = _STEP * float(noise / max(-bend, 1e-300)) if bend < 0.0 else _STEP
    return float(lags[k] + shift) * _STEP, min(max(error, 0.1 * _STEP), 0.1), correlation


def _smoothed(grid: Array, times: Array, values: Array, *, rate: bool) -> Array:
    """Return values, or their rate, averaged over a tenth of a second, on a grid; zero where there are none."""
    width = round(0.1 / _STEP)
    smooth = np.convolve(np.interp(grid, times, values), np.ones(width) / width, mode="same")
    result = np.gradient(smooth) if rate else smooth
    inside = (grid > times[0] + 0.1) & (grid < times[-1] - 0.1)
    result = result - np.mean(result[inside]) if inside.any() else result
    return np.where(inside, result, 0.0)
