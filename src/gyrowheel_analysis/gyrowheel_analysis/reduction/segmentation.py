"""From a recording, or from a plan, to the windows of its steady motion."""

from __future__ import annotations

import itertools
import math
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gyrowheel_analysis.criteria import CONE_DRIFT, CONE_OFF_SPEED, OTHER_RATE
from gyrowheel_analysis.reduction.clock import evened
from gyrowheel_analysis.reduction.mean_rates import acceleration_variance, planned_rate_variance
from gyrowheel_analysis.reduction.motor_temperature import motor_temperatures
from gyrowheel_analysis.reduction.quality import READING_NOISES, clipped_readings, readable, reading_noise
from gyrowheel_analysis.reduction.samples import Array, Samples, loop_period
from gyrowheel_analysis.reduction.window_fit import (
    FEWEST_REVOLUTIONS,
    FEWEST_SAMPLES,
    SHORTEST,
    fit_window,
)
from gyrowheel_analysis.reduction.windows import (
    DEGREE,
    MEAN,
    RISE,
    Coverage,
    MissedVoltages,
    Windows,
    attitude,
    still_row,
)
from gyrowheel_control.plans.plan import HOLD, Plan
from gyrowheel_core.readings import Readings
from gyrowheel_core.units import DEG
from gyrowheel_recording.bags.reader import PAUSE, pauses
from gyrowheel_recording.derived import assumed_rig
from gyrowheel_sim.bench import Bench

#: Settling time at the start of a steady motion [s]; the spin loop is the slower one.
SETTLING = 0.5
SPIN_SETTLING = 1.0
SPEED_CHANGE = 2.0  # rad/s; a change of speed beyond this gets SPIN_SETTLING
#: Further settling time of a cone after a change of speed [s]: its windows are too short to follow the spin loop.
CONE_SETTLING = 0.5
LONGEST = 2.0  # s; longer holds are split, so that drift within a window stays small
_ARC = 35.0 * DEG  # of a cone in one window
_LEAST_TURN = FEWEST_REVOLUTIONS + 0.1  # revolutions in a window of a cone

#: A steady motion: start, stop [s], segment, precession rate of the tilt [rad/s].
Span = tuple[float, float, int, float]


def steady_spans(data: Samples) -> list[Span]:
    """Return the steady motions within `Samples.part`: from the setpoints if there are any, else from the motion."""
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
        end = float(time[b - 1]) + step
        if b < len(time):
            end = min(end, float(time[b]))  # where setpoints are scattered, no hold lasts into the next one
        spans.append((float(time[a]) + settling, end, int(sp["segment"][a]), turn))
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

    `turn` and `spin` are the precession rate and the spin rate [rad/s].
    """
    return min(LONGEST, max(_ARC / turn, SHORTEST, _LEAST_TURN * 2.0 * math.pi / spin))


def window_count(length: float, longest: float, *, cone: bool) -> int:
    """Return the number of windows of a motion: each at least `longest` [s] on a cone, else at most."""
    return max(math.floor(length / longest) if cone else math.ceil(length / longest - 1e-6), 1)


def planned_windows(plan: Plan, bench: Bench) -> Windows:
    """Return the windows that a plan would give if the loops followed it exactly, to judge it before it is run.

    The bench gives the noise, the state of the air and the time constant of the heated coils.
    """
    h, noise = bench.sample_period, bench.value
    powers = np.arange(DEGREE + 1)
    rows: list[dict[str, Any]] = []
    warm = 0.0
    for s in plan.segments:
        # the coils reach the heater's temperature within a second and cool with their own time constant
        cooling = noise("coil_thermal_resistance") * noise("coil_heat_capacity")
        warm = s.environment.preheat or warm * math.exp(-(s.ramp + s.hold) / cooling)
        changed = abs(s.spin - s.spin_from) > SPEED_CHANGE
        settling = SPIN_SETTLING if changed else SETTLING
        if changed and s.cone_rate:
            settling += CONE_SETTLING
        length = s.hold - settling
        longest = LONGEST if s.cone_rate == 0.0 else cone_window(abs(s.cone_rate), s.spin)
        count = window_count(length, longest, cone=bool(s.cone_rate))
        duration = length / count
        if duration < SHORTEST or duration * s.spin < FEWEST_REVOLUTIONS * 2.0 * math.pi:
            continue
        slope = (s.spin_end - s.spin) / s.hold
        for k in range(count):
            middle = settling + (k + 0.5) * duration
            turn = 1j * s.cone_rate * 0.5 * duration
            series = np.array([turn**n / math.factorial(n) for n in powers])
            spin = np.zeros(DEGREE)
            spin[:2] = s.spin + slope * middle, slope * 0.5 * duration
            samples = duration / h
            rows.append(
                still_row()
                | {
                    "start": s.start + s.ramp + middle - 0.5 * duration,
                    "duration": duration,
                    "samples": samples,
                    "segment": -1,
                    "tilt": s.tilt * np.exp(1j * s.cone_rate * middle) * series,
                    "spin": spin,
                    "coil_temperature": noise("air_temperature") + warm,
                    "air_temperature": noise("air_temperature"),
                    "air_pressure": noise("air_pressure") * s.environment.air_density_ratio,
                    "motor_temperatures": np.full(2, noise("air_temperature")),
                    **attitude(s.environment),
                    "tilt_rate_variance": planned_rate_variance(
                        duration, samples, s.spin + slope * middle, bench
                    ),
                    "spin_acceleration_variance": acceleration_variance(
                        duration,
                        samples,
                        noise("spin_angle_noise"),
                        noise("motor_constant") / bench.axial_inertia * noise("motor_current_noise"),
                    ),
                    "reading_noise": np.array([noise(name) for name in READING_NOISES]),
                }
            )
    return Windows.of(rows)


_SETTLES_BY = 0.2  # s; by which a window is shortened at an end where the motion is not steady
#: Reasons why steady motion lies in no window.
_TOO_FEW = "with too few samples or revolutions"
_UNREAD = "with readings missing"
_CLIPPED = "with a reading at the end of its range"
_UNSETTLED = "with a motion or motor current that had not settled"
_OFF_SPEED = "of a cone before its speed was reached"


def reduce(data: Samples, bench: Bench, *, weighed: bool = True) -> Windows:
    """Reduce a recording to windows of whole revolutions; see `reduce_and_account`."""
    return reduce_and_account(data, bench, weighed=weighed)[0]


def reduce_and_account(data: Samples, bench: Bench, *, weighed: bool = True) -> tuple[Windows, Coverage]:
    """Reduce a recording to windows of whole revolutions, in time order, and return the coverage of its steady motion.

    There are no windows without steady motion. A reading that is not finite was not taken, see `readable`; the bench
    gives the noise of the readings. Windows that are not `weighed` lack what only the weight of their rows needs: the
    leakage of their harmonics, and the share of outliers in their noise.
    """
    h = data.period(bench.sample_period)
    length = 0.0
    if len(data.time):
        begin, end = max(float(data.time[0]) - h, data.part[0]), min(float(data.time[-1]), data.part[1])
        length = max(end - begin, 0.0)
    sampled = data.time
    data, without, assumed = readable(data, bench)
    data = evened(data, h)
    rows: list[dict[str, Any]] = []
    used, left_out = 0.0, defaultdict[str, float](float)
    noise = reading_noise(data, bench)
    clipped = clipped_readings(data)
    heat = motor_temperatures(data, bench)
    loop = loop_period(data, h, bench)

    def fit(i: int, j: int) -> dict[str, Any] | None:
        # samples faster than the loop show a voltage more than once
        return fit_window(data, i, j, (h, min(h, loop), loop), bench, heat, noise, weighed=weighed)

    spans = steady_spans(data)
    for start, stop, segment, turn in _unbroken(spans, _without_samples(sampled, spans)):
        if stop <= start:
            continue  # a hold that ends before it has settled
        longest, last = LONGEST, 0.0
        if turn > 0.0:
            first, end = np.searchsorted(data.time, (start, stop))
            inside = data.readings.spin_rate[first:end]
            speed = float(np.median(inside)) if len(inside) else math.nan
            if not speed > 0.0:
                left_out[_why_too_few(data.time, without, start, stop, h)] += stop - start
                continue
            last = float(np.median(inside[-max(len(inside) // 10, 1) :]))
            longest = cone_window(turn, speed)
        count = window_count(stop - start, longest, cone=bool(turn))
        edges = np.linspace(start, stop, count + 1)
        for a, b in itertools.pairwise(edges):
            row, (begin, end), why = _window(data, clipped, fit, a, b, last if turn else None)
            if row is None:
                left_out[why or _why_too_few(data.time, without, begin, end, h)] += b - a
                continue
            row["segment"] = segment
            rows.append(row)
            unread = h * float(np.diff(np.searchsorted(without, (begin, end)))[0])
            used += end - begin - unread
            if unread > 0.0:
                left_out[_UNREAD] += unread
            if end - begin < b - a:
                left_out[_UNSETTLED] += b - a - (end - begin)
    assumed = (*assumed_rig(data.environment), *assumed)
    missed = _missed(rows, h, loop, bench)
    return Windows.of(rows), Coverage(length, used, dict(left_out), assumed, missed)


def _missed(
    rows: Sequence[Mapping[str, Any]], period: float, loop: float, bench: Bench
) -> MissedVoltages | None:
    """Return what a sampling period longer than that of the loop costs; None where all voltages are recorded."""
    if period < (1.0 + OTHER_RATE) * loop or not rows:
        return None
    volts = READING_NOISES.index("coil_voltage_noise")
    noise = np.median([row["reading_noise"][volts] / math.sqrt(row["samples"]) for row in rows])
    return MissedVoltages(1.0 / period, 1.0 / loop, float(noise) * bench.value("coil_constant"))


def _without_samples(time: Array, spans: Sequence[Span]) -> Array:
    """Return the pauses between samples, and the time long before the first or after the last one."""
    found = pauses(time)
    if not len(time):
        return found
    first, last = float(time[0]), float(time[-1])
    early = any(start < first - PAUSE for start, *_ in spans)
    late = any(stop > last + PAUSE for _, stop, *_ in spans)
    before, after = [(-math.inf, first)] * early, [(last, math.inf)] * late
    return np.concatenate([np.reshape(before, (-1, 2)), found, np.reshape(after, (-1, 2))])


def _unbroken(spans: Sequence[Span], paused: Array) -> Iterator[Span]:
    """Yield the parts of steady motions between pauses, whose own motion is unknown."""
    for start, stop, segment, turn in spans:
        begin = start
        for last, first in paused[(paused[:, 1] > start) & (paused[:, 0] < stop)].tolist():
            yield begin, last, segment, turn
            begin = max(first, begin)
        yield begin, stop, segment, turn


def _window(
    data: Samples,
    clipped: NDArray[np.bool_],
    fit: Callable[[int, int], dict[str, Any] | None],
    begin: float,
    end: float,
    cone_speed: float | None,
) -> tuple[dict[str, Any] | None, tuple[float, float], str]:
    """Return the window between two times, its start and end, and why there is no window (empty: too few samples).

    The window of a hold that has not settled starts later, and one in whose last samples the next motion begins, as by
    setpoints of another clock, ends earlier. That of a cone cannot; it must have reached `cone_speed`.
    """
    why = ""
    while end - begin >= SHORTEST:
        i, j = (int(k) for k in np.searchsorted(data.time, (begin - 1e-9, end - 1e-9)))
        if clipped[i:j].any():
            return None, (begin, end), _CLIPPED
        row = fit(i, j)
        if row is None:
            return None, (begin, end), why
        unsettled, left = row.pop("unsettled"), row.pop("left")
        if cone_speed is not None and not _at_speed(row, cone_speed, end - begin):
            return None, (begin, end), _OFF_SPEED
        if not (unsettled or left):
            return row, (begin, end), ""
        why = _UNSETTLED
        if cone_speed is not None:
            break
        if left:  # what moves there is no reason to begin later
            end -= _SETTLES_BY
        else:
            begin += _SETTLES_BY
    return None, (begin, end), why


def _why_too_few(time: Array, without: Array, start: float, stop: float, h: float) -> str:
    """Return why there are too few samples between two times: unread, if the omitted ones would have sufficed."""
    have, unread = (int(np.diff(np.searchsorted(times, (start, stop)))[0]) for times in (time, without))
    needed = FEWEST_SAMPLES * (stop - start) / h
    return _UNREAD if have < needed <= have + unread else _TOO_FEW


def _at_speed(row: dict[str, Any], last: float, length: float) -> bool:
    """Whether the rotor has reached the speed of a cone, and is not at a turning point of it."""
    change, mean = row["spin"] @ RISE[:DEGREE], row["spin"] @ MEAN[:DEGREE]
    return abs(change) <= CONE_DRIFT * length and abs(mean - last) <= CONE_OFF_SPEED * last
