"""The windows of a recording."""

from __future__ import annotations

import itertools
import math
from typing import Any

import numpy as np

from gyrowheel_analysis.reduction.motor_heat import motor_temperatures
from gyrowheel_analysis.reduction.readings import clipped_readings, reading_noise
from gyrowheel_analysis.reduction.samples import Samples
from gyrowheel_analysis.reduction.spans import LONGEST, SHORTEST, cone_window, steady_spans, window_count
from gyrowheel_analysis.reduction.window_fit import fit_window
from gyrowheel_analysis.reduction.windows import DEGREE, MEAN, RISE, Windows
from gyrowheel_sim.bench import Bench

#: A window of a cone in which the speed changes faster than so [rad/s^2], or is farther from the last one, is left out.
_CONE_DRIFT, _CONE_OFF = 2.0, 0.01
_SETTLES_BY = 0.2  # s; by so much later a window begins if its motion has not settled


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
    clipped = clipped_readings(data)
    heat = motor_temperatures(data, bench)
    for start, stop, segment, turn in steady_spans(data):
        longest, last = LONGEST, 0.0
        if turn > 0.0:
            first, end = np.searchsorted(data.time, (start, stop))
            inside = data.values[first:end, 3]
            speed = float(np.median(inside)) if len(inside) else math.nan
            if not speed > 0.0:
                continue
            last = float(np.median(inside[-max(len(inside) // 10, 1) :]))
            longest = cone_window(turn, speed)
        count = window_count(stop - start, longest, cone=bool(turn))
        edges = np.linspace(start, stop, count + 1)
        for a, b in itertools.pairwise(edges):
            row = None
            while row is None and b - a >= SHORTEST:
                i, j = (int(k) for k in np.searchsorted(data.time, (a - 1e-9, b - 1e-9)))
                if clipped[i:j].any():
                    break
                row = fit_window(data, i, j, h, bench, heat, noise)
                if turn and row is not None and not _at_speed(row, last, b - a):
                    row = None
                if turn or row is None or not row.pop("unsettled"):
                    break
                row, a = None, a + _SETTLES_BY
            if row is not None and not row.pop("unsettled", False):
                row["segment"] = segment
                rows.append(row)
    return Windows.of(rows)


def _at_speed(row: dict[str, Any], last: float, length: float) -> bool:
    """Whether the rotor has come to the speed of a cone: it neither changes nor is it at a turning point."""
    change, mean = row["spin"] @ RISE[:DEGREE], row["spin"] @ MEAN[:DEGREE]
    return abs(change) <= _CONE_DRIFT * length and abs(mean - last) <= _CONE_OFF * last
