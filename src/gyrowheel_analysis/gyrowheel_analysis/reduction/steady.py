"""Steady motion in a recording, and the lengths of the windows into which it is divided."""

from __future__ import annotations

import math

import numpy as np

from gyrowheel_analysis.reduction.samples import Samples
from gyrowheel_control.plans.plan import HOLD
from gyrowheel_core.readings import Readings
from gyrowheel_core.units import DEG

#: Settling time at the start of a steady motion [s]; the spin loop is the slower one.
SETTLING = 0.5
SPIN_SETTLING = 1.0
SPEED_CHANGE = 2.0  # rad/s; a change of speed beyond this gets SPIN_SETTLING
#: Further settling time of a cone after a change of speed [s]: its windows are too short to follow the spin loop.
CONE_SETTLING = 0.5
LONGEST = 2.0  # s; longer holds are split, so that drift within a window stays small
SHORTEST = 0.16  # s
FEWEST_REVOLUTIONS = 4  # of a window; with fewer, harmonics and slow motion are hard to separate
_ARC = 35.0 * DEG  # of a cone in one window
_LEAST_TURN = FEWEST_REVOLUTIONS + 0.1  # revolutions in a window of a cone

#: A steady motion: start, stop [s], segment, precession rate of the tilt [rad/s].
Span = tuple[float, float, int, float]


def steady_spans(data: Samples) -> list[Span]:
    """Return the steady motions.

    They come from the setpoints if there are any, else from the motion itself; those outside the part of the recording
    that is looked at (`Samples.part`) are left out.
    """
    spans = _spans_from_setpoints(data) if len(data.setpoint_time) else _spans_from_motion(data)
    first, last = data.part
    clipped = [(max(begin, first), min(end, last), segment, turn) for begin, end, segment, turn in spans]
    return [span for span in clipped if span[1] > span[0]]


def _spans_from_setpoints(data: Samples) -> list[Span]:
    sp, time = data.setpoint, data.setpoint_time
    steps = np.diff(time)
    step = float(np.median(steps[steps > 0.0])) if np.any(steps > 0.0) else 0.005
    key = sp["segment"].astype(np.int64) * 2 + (sp["phase"] == HOLD)
    edges = np.flatnonzero(np.diff(key)) + 1
    spans = []
    for a, b in zip(np.r_[0, edges], np.r_[edges, len(key)], strict=True):
        if sp["phase"][a] != HOLD:
            continue
        changed = (
            a > 0 and abs(sp["spin_rate"][a] - sp["spin_rate"][max(a - round(0.5 / step), 0)]) > SPEED_CHANGE
        )
        settling = SPIN_SETTLING if changed else SETTLING
        speed = math.hypot(sp["tilt_rate_x"][a], sp["tilt_rate_y"][a])
        radius = math.hypot(sp["tilt_x"][a], sp["tilt_y"][a])
        turn = speed / radius if radius > 0.0 and math.isfinite(speed / radius) else 0.0
        if changed and turn > 0.0:
            settling += CONE_SETTLING
        spans.append((float(time[a]) + settling, float(time[b - 1]) + step, int(sp["segment"][a]), turn))
    return spans


def _spans_from_motion(data: Samples) -> list[Span]:
    """Find steady motion without setpoints: tilt rate and spin acceleration change little over 0.25 s."""
    if len(data.time) < 2:
        return []
    h = float(np.median(np.diff(data.time)))
    block = max(round(0.05 / h), 1)
    n = len(data.time) // block
    if n < 10:
        return []
    time = data.time[: n * block].reshape(n, block).mean(axis=1)
    means = Readings(data.readings.array[: n * block].reshape(n, block, -1).mean(axis=1))
    tilt, spin = means.tilt_x + 1j * means.tilt_y, means.spin_rate
    rate = np.gradient(tilt, time)
    bend = np.abs(np.gradient(rate, time))
    jerk = np.abs(np.gradient(np.gradient(spin, time), time))
    # a cone of 4 deg in 2.5 s bends by 25 deg/s^2; the corners of a ramp by several hundred
    calm = (bend < 0.6 * np.maximum(np.abs(rate) * 4.0, 0.05)) & (jerk < 15.0)
    calm = np.convolve(calm, np.ones(5), mode="same") >= 5
    edges = np.flatnonzero(np.diff(np.r_[0, calm.astype(int), 0]))
    spans = []
    for a, b in zip(edges[::2], edges[1::2], strict=True):
        speed, radius = float(np.median(np.abs(rate[a:b]))), float(np.median(np.abs(tilt[a:b])))
        turn = speed / radius if speed > 0.5 * DEG and radius > 0.2 * DEG else 0.0
        spans.append((float(time[a]) + 0.5 * SETTLING, float(time[b - 1]), -1, turn))
    return spans


def cone_window(turn: float, spin: float) -> float:
    """Return the length of the windows of a cone [s]: a short arc, but enough whole revolutions.

    Parameters
    ----------
    turn, spin : float
        Precession rate and spin rate [rad/s].
    """
    return min(LONGEST, max(_ARC / turn, SHORTEST, _LEAST_TURN * 2.0 * math.pi / spin))


def window_count(length: float, longest: float, *, cone: bool) -> int:
    """Return the number of windows of a motion: each at least `longest` [s] on a cone, else at most."""
    return max(math.floor(length / longest) if cone else math.ceil(length / longest - 1e-6), 1)
