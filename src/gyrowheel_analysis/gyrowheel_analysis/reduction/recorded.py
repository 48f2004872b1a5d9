"""Reduction of a recording to windows."""

from __future__ import annotations

import itertools
import math
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gyrowheel_analysis.criteria import CONE_DRIFT, CONE_OFF_SPEED
from gyrowheel_analysis.reduction.coverage import Coverage
from gyrowheel_analysis.reduction.instants import evened
from gyrowheel_analysis.reduction.loop_rate import loop_period
from gyrowheel_analysis.reduction.motor_temperature import motor_temperatures
from gyrowheel_analysis.reduction.quality import clipped_readings, readable, reading_noise
from gyrowheel_analysis.reduction.samples import Array, Samples
from gyrowheel_analysis.reduction.steady import (
    LONGEST,
    SHORTEST,
    Span,
    cone_window,
    steady_spans,
    window_count,
)
from gyrowheel_analysis.reduction.window_fit import FEWEST_SAMPLES, fit_window
from gyrowheel_analysis.reduction.windows import DEGREE, MEAN, RISE, Windows
from gyrowheel_recording.bags.sampling import PAUSE, pauses
from gyrowheel_sim.bench import Bench

_SETTLES_BY = 0.2  # s; delay of the start of a window whose motion has not settled
#: Reasons why steady motion lies in no window.
_TOO_FEW = "with too few samples or revolutions"
_UNREAD = "with readings missing"
_CLIPPED = "with a reading at the end of its range"
_UNSETTLED = "with a motion or motor current that had not settled"
_OFF_SPEED = "of a cone before its speed was reached"


def reduce(data: Samples, bench: Bench) -> Windows:
    """Reduce a recording to windows of whole revolutions; see `reduce_and_account`."""
    return reduce_and_account(data, bench)[0]


def reduce_and_account(data: Samples, bench: Bench) -> tuple[Windows, Coverage]:
    """Reduce a recording to windows of whole revolutions, and account for what is not used.

    Parameters
    ----------
    data : Samples
        The recording; a reading that is not finite was not taken, see `readable`.
    bench : Bench
        Gives the noise of the readings.

    Returns
    -------
    windows : Windows
        In time order; empty if the recording has no steady motion.
    coverage : Coverage
        How much of the steady motion is used.
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
        # samples that follow each other faster than the loop show a voltage more than once
        return fit_window(data, i, j, (h, min(h, loop), loop), bench, heat, noise)

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
            row, begin, why = _window(data, clipped, fit, a, b, last if turn else None)
            if row is None:
                left_out[why or _why_too_few(data.time, without, begin, b, h)] += b - a
                continue
            row["segment"] = segment
            rows.append(row)
            unread = h * float(np.diff(np.searchsorted(without, (begin, b)))[0])
            used += b - begin - unread
            if unread > 0.0:
                left_out[_UNREAD] += unread
            if begin > a:
                left_out[_UNSETTLED] += begin - a
    return Windows.of(rows), Coverage(length, used, dict(left_out), assumed)


def _without_samples(time: Array, spans: Sequence[Span]) -> Array:
    """Return the pauses between samples, and what lies long before the first or after the last one."""
    found = pauses(time)
    if not len(time):
        return found
    first, last = float(time[0]), float(time[-1])
    early = any(start < first - PAUSE for start, *_ in spans)
    late = any(stop > last + PAUSE for _, stop, *_ in spans)
    before, after = [(-math.inf, first)] * early, [(last, math.inf)] * late
    return np.concatenate([np.reshape(before, (-1, 2)), found, np.reshape(after, (-1, 2))])


def _unbroken(spans: Sequence[Span], paused: Array) -> Iterator[Span]:
    """Yield the parts of steady motions between pauses; of a pause nobody knows whether it was steady."""
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
) -> tuple[dict[str, Any] | None, float, str]:
    """Return the window between two times, its start, and why there is none (empty: too few samples).

    The window of a hold that has not settled starts later. That of a cone cannot; it must have reached `cone_speed`.
    """
    why = ""
    while end - begin >= SHORTEST:
        i, j = (int(k) for k in np.searchsorted(data.time, (begin - 1e-9, end - 1e-9)))
        if clipped[i:j].any():
            return None, begin, _CLIPPED
        row = fit(i, j)
        if row is None:
            return None, begin, why
        unsettled = row.pop("unsettled")
        if cone_speed is not None and not _at_speed(row, cone_speed, end - begin):
            return None, begin, _OFF_SPEED
        if not unsettled:
            return row, begin, ""
        why = _UNSETTLED
        if cone_speed is not None:
            break
        begin += _SETTLES_BY
    return None, begin, why


def _why_too_few(time: Array, without: Array, start: float, stop: float, h: float) -> str:
    """Return why there are too few samples between two times: unread, if with those left out there are enough."""
    have, unread = (int(np.diff(np.searchsorted(times, (start, stop)))[0]) for times in (time, without))
    needed = FEWEST_SAMPLES * (stop - start) / h
    return _UNREAD if have < needed <= have + unread else _TOO_FEW


def _at_speed(row: dict[str, Any], last: float, length: float) -> bool:
    """Whether the rotor has reached the speed of a cone: it does not change, and is not at a turning point."""
    change, mean = row["spin"] @ RISE[:DEGREE], row["spin"] @ MEAN[:DEGREE]
    return abs(change) <= CONE_DRIFT * length and abs(mean - last) <= CONE_OFF_SPEED * last
