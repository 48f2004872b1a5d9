"""The notch filter of the published ground test: it removes the harmonics of the spin speed from the readings."""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from gyrowheel_core.readings import Readings
from gyrowheel_sim.jit import njit

#: Readings that are filtered, and their columns among all.
FILTERED: Final = ("tilt_x", "tilt_y", "coil_voltage_x", "coil_voltage_y", "motor_voltage", "motor_current")
COLUMNS: Final = np.array(Readings.columns(FILTERED))
#: Radius of the poles: 10 Hz wide, settles in 0.1 s.
RADIUS: Final = 0.97


def notched(readings: Readings, needed: tuple[str, ...], period: float) -> dict[str, NDArray[np.float64]]:
    """Return the readings `FILTERED` by name, filtered as the drag estimator averages them; NaN where a sample is lost.

    A sample without one of the readings `needed` counts as lost; `period` is the sampling interval [s].
    """
    whole = readings.whole(needed)
    state, every = np.full(4 * len(COLUMNS) + 1, math.nan), np.full((len(readings), len(COLUMNS)), math.nan)
    own, found = readings[whole], np.empty((int(whole.sum()), len(COLUMNS)))
    notch(own.array, COLUMNS, own.spin_rate, period, RADIUS, state, found)
    every[whole] = found
    return {name: every[:, k] for k, name in enumerate(FILTERED)}


@njit(cache=True, error_model="numpy")
def notch(values: Any, columns: Any, rate: Any, period: float, radius: float, state: Any, out: Any) -> None:
    """Filter the k `columns` of `values` (m, n) to `out` (m, k) by notches at once and twice the tracked spin rate.

    The tracked rate is the first-order low-pass of `rate` (m,) [rad/s]; `period` is the sampling interval [s], `radius`
    that of the poles. `state` (2 * 2 * k + 1,) has the filter memory, then the tracked rate; all NaN before the first
    sample.
    """
    k = len(columns)
    smooth = 1.0 - math.exp(-2.0 * math.pi * 5.0 * period)
    for i in range(len(values)):
        first = math.isnan(state[4 * k])
        if first:
            state[4 * k] = rate[i]
        state[4 * k] += smooth * (rate[i] - state[4 * k])
        for c in range(k):
            x = values[i, columns[c]]
            for order in range(2):
                cosine = math.cos((order + 1) * state[4 * k] * period)
                # unit gain at zero frequency
                gain = (1.0 - 2.0 * radius * cosine + radius * radius) / (2.0 - 2.0 * cosine)
                at = 4 * c + 2 * order
                if first:  # start in the steady state of a constant input
                    state[at + 1] = x * (gain - radius * radius)
                    state[at] = x * (1.0 - gain)
                y = gain * x + state[at]
                state[at] = -2.0 * cosine * gain * x + 2.0 * radius * cosine * y + state[at + 1]
                state[at + 1] = gain * x - radius * radius * y
                x = y
            out[i, c] = x
