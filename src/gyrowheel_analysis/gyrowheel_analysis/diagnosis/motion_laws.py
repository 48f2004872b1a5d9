"""Laws that look like events: smooth functions of speed, tilt, direction, temperatures and time, and of their past.

A law that a model lacks acts in steps, as plans command speeds and tilts in steps. An event is believed where it makes
a recording likelier than every such function in its place.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gyrowheel_analysis.criteria import BURST_BESIDE, EVENT_COMMANDED
from gyrowheel_analysis.diagnosis.dated_changes import Variable
from gyrowheel_analysis.diagnosis.event_scan import chance
from gyrowheel_analysis.diagnosis.evidence import Array, Evidence, Profiles
from gyrowheel_analysis.fitting.events import (
    HAPPENS,
    QUANTITIES,
    TOGETHER,
    Event,
    is_law,
    lead,
    unit_rows,
)
from gyrowheel_analysis.fitting.problem import Problem
from gyrowheel_analysis.reduction.windows import SAME_SPEED, UPRIGHT, Windows, speed_groups
from gyrowheel_core.units import DEG

_SMALLEST = 0.02  # range of a course, over its largest value, below which it is a constant
_WIDTHS = (0.03, 0.1, 0.3)  # of a bump or a resonance, over the range of the speeds
_FADING = (0.05, 0.15, 0.4)  # times, over the length of the recording
_LAGS = (3.0, 10.0, 30.0, 100.0)  # s in which the past is forgotten
_HELD = 0.5 * DEG  # rad/s, of a tilt up to which it is held: the rest is noise
_LOBES = (1, 2, 3, 4)
_PHASES = 4


@dataclass(frozen=True)
class MotionLaw:
    """A function of the motion in place of an event: on what it depends, and which quantities follow it.

    `course` (n,) has its values over the windows of the recording, `score` is the increase of twice the log likelihood
    less that which chance brings with one of all functions. `lag` is the relaxation time of a torque that follows the
    tilt with a delay [s].
    """

    variable: Variable
    recording: int
    quantities: tuple[str, ...]
    course: Array
    score: float
    lag: float | None = None


def law_instead(evidence: Evidence, events: Sequence[Event], score: float) -> MotionLaw | None:
    """Return the function of the motion that explains a recording as well as an event; None without one.

    `score` is that of the event. A step with hardly anything before it is an offset. An event whose edges all lie on
    changes of the commanded speed must be better by more than others: few events of all happen then.
    """
    first = events[0]
    windows = evidence.problem.balances[first.recording].windows
    quantities = tuple(event.quantity for event in events)
    if first.kind == "step" and np.count_nonzero(windows.middle < first.time) < BURST_BESIDE:
        return MotionLaw("offset", first.recording, quantities, np.ones(len(windows)), score)
    best = _best(evidence, first.recording)
    margin = EVENT_COMMANDED if first.kind in HAPPENS and on_commands(windows, first) else 0.0
    return best if best is not None and best.score > score - margin else None


def law_of_shape(problem: Problem, event: Event, score: float) -> MotionLaw | None:
    """Return a shape as a law, which a term of the model must describe; None where it is the shape of a drift."""
    if not is_law(event.kind, event.quantity):
        return None
    late = event.kind == "after_tilt"
    course = event.course(problem.balances[event.recording].windows)
    variable: Variable = "history" if late else "temperature"
    return MotionLaw(
        variable, event.recording, (event.quantity,), course, score, event.time if late else None
    )


def gain_of_law(evidence: Evidence, law: MotionLaw) -> float:
    """Return the gain of a law in twice the log likelihood."""
    course = Profiles("step", np.zeros((1, 0)), law.course[None, :])
    (gains,) = evidence.gains(law.quantities, law.recording, [course], law.lag)
    return float(gains[0])


def on_commands(windows: Windows, event: Event) -> bool:
    """Whether every edge of an event lies within a window of a change of the commanded speed."""
    start, stop = windows.start, windows.start + windows.duration
    spin = windows.mean_spin
    after = np.flatnonzero(np.abs(np.diff(spin)) > SAME_SPEED * np.abs(spin[:-1])) + 1
    return all(np.any((start[after - 1] <= edge) & (edge <= stop[after])) for edge in event.edges)


def rows_of(problem: Problem, laws: Sequence[MotionLaw]) -> Array | None:
    """Return the rows (N, k) of large sizes of all quantities that follow laws; None without laws."""
    if not laws:
        return None
    edges = np.cumsum([0, *(len(b) for b in problem.balances)])
    columns = []
    for law in laws:
        balance = problem.balances[law.recording]
        for name in law.quantities:
            own = np.zeros(int(edges[-1]))
            unit = unit_rows(balance, QUANTITIES[name], law.lag) * QUANTITIES[name].width(problem.bench)
            own[edges[law.recording] : edges[law.recording + 1]] = unit * np.tile(
                law.course, len(balance.rows)
            )
            columns.append(own)
    return np.column_stack(columns)


def _best(evidence: Evidence, recording: int) -> MotionLaw | None:
    """Return the function of the motion that explains a recording best."""
    found = list(courses(evidence.problem.balances[recording].windows))
    every = Profiles("step", np.zeros((len(found), 0)), np.array([course for _, course in found]))
    price = chance("step", len(found))
    best: MotionLaw | None = None
    for quantities in TOGETHER:
        (gains,) = evidence.gains(quantities, recording, [every])
        k = int(np.argmax(gains))
        if best is None or gains[k] - price > best.score:
            variable, course = found[k]
            best = MotionLaw(variable, recording, quantities, course, float(gains[k]) - price)
    return best


def courses(windows: Windows) -> Iterator[tuple[Variable, Array]]:
    """Yield smooth functions of the motion over windows in the order of time, each at most one in size."""
    for variable, values in _values(windows):
        size = float(np.abs(values).max(initial=0.0))
        if variable == "offset" or (size > 0.0 and np.ptp(values) > _SMALLEST * size):
            yield variable, values / size


def _values(windows: Windows) -> Iterator[tuple[Variable, NDArray[np.float64]]]:
    w, spin, tilt = windows, windows.mean_spin, np.abs(windows.mean_tilt)
    yield "offset", np.ones(len(w))
    groups = [float(spin[group].mean()) for group in speed_groups(spin)]
    if len(groups) > 1:
        yield from (("speed", spin**power) for power in (-1, 1, 2, 3, 4))
        for place in groups:
            for width in _WIDTHS:
                off = (spin - place) / (width * float(np.ptp(spin)))
                yield "speed", np.exp(-(off**2))
                yield "speed", off / (1.0 + off**2)
        yield from (("speed", np.maximum(spin - place, 0.0)) for place in groups[1:-1])
    steps = np.unique(np.round(tilt / UPRIGHT)) * UPRIGHT
    if len(steps) > 1:
        yield from (("tilt", tilt**power) for power in (1, 2, 3, 4))
        for edge in steps[1:-1][:: max(len(steps) // 4, 1)]:
            yield "tilt", np.maximum(tilt - edge, 0.0)
        yield "tilt", tilt * spin
        yield "tilt", tilt**2 * spin**2
    tilted = np.where(tilt > UPRIGHT, 1.0, 0.0)
    for lobes in _LOBES:
        for phase in np.arange(_PHASES) * np.pi / _PHASES:
            wave = tilted * np.cos(lobes * np.angle(w.mean_tilt) - phase)
            yield "direction", wave
            if len(groups) > 1:
                yield "direction", wave * spin**2
    rate = np.abs(w.mean_tilt_rate)
    rate = np.where(rate > _HELD, rate, 0.0)
    yield "rate", np.sign(rate)
    # a rotor that is moved needs a torque in proportion to rate and speed
    for size in (rate, rate * spin) if len(groups) > 1 else (rate,):
        yield from (("rate", size**power) for power in (1, 2, 3))
    for warmth in (w.coil_temperature, *w.motor_temperatures.T):
        yield "temperature", warmth - float(warmth.min(initial=np.inf))
    since = w.middle - float(w.start.min(initial=0.0))
    yield "time", since
    yield from (("time", np.exp(-since / (part * float(since.max(initial=1.0))))) for part in _FADING)
    if len(groups) > 1:
        turned = np.abs(np.diff(spin)) > SAME_SPEED * np.abs(spin[:-1])
        last = np.maximum.accumulate(np.where(turned, np.arange(len(turned)), -1))
        yield "history", np.r_[0.0, np.where(last >= 0, np.sign(np.diff(spin))[last], 0.0)]
        yield "history", np.maximum.accumulate(spin)
        yield from (("history", lead(w, spin, time, float(spin[0])).real) for time in _LAGS)
    yield "history", np.maximum.accumulate(tilt)
    yield from (("history", lead(w, tilt, time, float(tilt[0])).real) for time in _LAGS)
