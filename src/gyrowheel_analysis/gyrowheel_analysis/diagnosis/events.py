"""Events in recordings: found, dated, and made part of the fit, so that no effect is invented to explain them."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gyrowheel_analysis.criteria import (
    EVENT_GAIN,
    EVENT_LACK,
    EVENT_NEAR,
    EVENT_SAME,
    EVENT_SEARCH,
    EVENT_SEARCH_MOST,
    EVENT_SIMPLER,
    EVENT_TIE,
    TREND_SHORTEST_REFINED,
)
from gyrowheel_analysis.diagnosis.dated_changes import DatedEvent, DriftShape
from gyrowheel_analysis.diagnosis.event_scan import Candidate, scan
from gyrowheel_analysis.diagnosis.evidence import Evidence, Profiles
from gyrowheel_analysis.diagnosis.proof import lack_of_fit
from gyrowheel_analysis.diagnosis.selection import Progress, Selection, select
from gyrowheel_analysis.diagnosis.unknown import Proposal, search
from gyrowheel_analysis.fitting.events import (
    HAPPENS,
    MOTION,
    QUANTITIES,
    TEMPERATURES,
    TOGETHER,
    Event,
    temperature,
)
from gyrowheel_analysis.fitting.fit import Fit, Term
from gyrowheel_analysis.fitting.preparation import Prepared, samples_of
from gyrowheel_analysis.fitting.problem import Problem
from gyrowheel_analysis.reduction.onset import onset
from gyrowheel_analysis.reduction.quality import readable
from gyrowheel_analysis.reduction.windows import Windows
from gyrowheel_recording.bags import Recording, parted

Array = NDArray[np.float64]

_MOST = 6
_ROUNDS = 3  # of selecting effects given events and searching events given effects
_FINE = 0.1  # s between tried edges within windows
_TIMES = 10_000  # tried times of an edge, at most
_ENDS = 25  # tried times of each end of a trend
#: Readings whose shift looks like a torque in every window.
_READINGS = {"torque_x": ("coil_voltage_x",), "torque_y": ("coil_voltage_y",)}


@dataclass(frozen=True)
class Found:
    """An event before its size is known.

    `events` has the change of every quantity, all with the same recording, kind and edges; `errors` are the standard
    errors of the edges [s], `gain` is the increase of twice the log likelihood, and `ties` are other quantities that
    explain it as well.
    """

    events: tuple[Event, ...]
    errors: tuple[float, ...]
    gain: float
    ties: tuple[str, ...] = ()

    @property
    def event(self) -> Event:
        """The first of them."""
        return self.events[0]


def all_of(found: Sequence[Found]) -> list[Event]:
    """Return the single events of several changes."""
    return [event for own in found for event in own.events]


@dataclass(frozen=True)
class Outcome:
    """The explanation of recordings: effects given the events, and a free form if there is one.

    `problem` has the events, their contribution subtracted from the measured rows; they are in order of recording and
    time.
    """

    problem: Problem
    selection: Selection
    proposal: Proposal | None
    events: list[Found]

    @property
    def fit(self) -> Fit:
        """The fit with the free form, or with the effects."""
        return self.proposal.fit if self.proposal else self.selection.best

    @property
    def evidence(self) -> float:
        """Minus twice the log likelihood, with the price of the events."""
        return self.problem.evidence(self.fit) + EVENT_GAIN * len(self.events)


def explain(
    problem: Problem, selection: Selection, recordings: Sequence[Recording], progress: Progress | None = None
) -> Outcome:
    """Search for events, and for effects or a free form given these events.

    Events are accepted if they, with the effects found given them, make the recordings likelier than effects and a free
    form do without events, and leave little unexplained. `problem` and `selection` are without events.
    """
    found = find(problem, selection.best, recordings)
    without = Outcome(problem, selection, search(problem, selection, progress=progress), [])
    if not found:
        return without
    if without.proposal is not None:
        with_events = problem.with_events(all_of(found))
        gain = problem.evidence(selection.best) - with_events.evidence(selection.best)
        if without.proposal.gain > gain - EVENT_GAIN * len(found):
            found = find(problem, without.fit, recordings)
    best = without
    for _ in range(_ROUNDS):
        if not found:
            return without
        if progress:
            progress(f"{len(found)} event{'s' * (len(found) > 1)}: looking again for missing effects")
        best = _beside(problem, found)
        again = find(problem, best.fit, recordings)
        if _same(found, again):
            break
        found = again
    if best.evidence > without.evidence or lack_of_fit(best.problem, best.fit) > EVENT_LACK:
        return without
    # so that the shown residual is free of events
    cleared = best.problem.without_events(best.fit)
    selection = select(cleared)
    return Outcome(
        cleared,
        selection,
        search(cleared, selection),
        sorted(best.events, key=lambda f: (f.event.recording, f.event.time)),
    )


def _beside(problem: Problem, found: list[Found]) -> Outcome:
    """Return effects and free form, given events."""
    beside = problem.with_events(all_of(found)).with_drift_estimated()
    selection = select(beside)
    return Outcome(beside, selection, search(beside, selection), found)


def find(problem: Problem, fit: Fit, recordings: Sequence[Recording]) -> list[Found]:
    """Return the events that recordings show in addition to a fit, the strongest first."""
    found: list[Found] = []
    while len(found) < _MOST:
        evidence = Evidence(problem.with_events(all_of(found)), fit)
        candidates = scan(evidence)
        best = _simplest(candidates)
        if best.score < EVENT_GAIN:
            break
        recording = recordings[best.first.recording]
        dated = _dated(evidence, best, recording)
        if best.first.kind == "trend" and (steps := [c for c in candidates if _may_be(c, best)]):
            # a step within a window looks like a short trend
            step = _dated(evidence, steps[0], recording)
            dated = step if step.gain > dated.gain - EVENT_SIMPLER else dated
        dated = _fewer(evidence, dated)
        if any(_alike(dated.events, f.events) for f in found):
            break
        found.append(replace(dated, ties=_ties(candidates, best)))
    return found


def _may_be(candidate: Candidate, trend: Candidate) -> bool:
    """Whether a candidate is a step that may explain a trend."""
    e, t = candidate.first, trend.first
    return (e.kind, e.recording, candidate.quantities) == ("step", t.recording, trend.quantities) and (
        t.time - EVENT_NEAR < e.time < t.end + EVENT_NEAR
    )


def _fewer(evidence: Evidence, dated: Found) -> Found:
    """Return the event of one axis alone in place of both, where it explains as much."""
    alone = [replace(dated, events=(event,), gain=_gain(evidence, [(event,)])) for event in dated.events]
    best = max(alone, key=lambda own: own.gain)
    return best if best.gain > dated.gain - EVENT_SIMPLER else dated


def _alike(left: Sequence[Event], right: Sequence[Event]) -> bool:
    """Whether two events are the same change of the same quantities."""
    if [(e.recording, e.quantity, e.kind) for e in left] != [
        (e.recording, e.quantity, e.kind) for e in right
    ]:
        return False
    return all(abs(a - b) < EVENT_SAME for a, b in zip(left[0].edges, right[0].edges, strict=True))


def _ties(candidates: Sequence[Candidate], best: Candidate) -> tuple[str, ...]:
    """Return other quantities whose change at the same time gains nearly as much."""
    first = best.first
    near = [
        name
        for c in candidates
        if c.gain > best.gain - EVENT_TIE
        and c.quantities != best.quantities
        and (c.first.recording, c.first.kind) == (first.recording, first.kind)
        and all(abs(a - b) < EVENT_NEAR for a, b in zip(c.first.edges, first.edges, strict=True))
        for name in c.quantities
    ]
    return tuple(dict.fromkeys(near))


def accepted(problem: Problem, fit: Fit, recordings: Sequence[Recording]) -> list[Found]:
    """Return the events that effects and free forms do not explain better (`explain`)."""
    if not find(problem, fit, recordings):
        return []
    return explain(problem, select(problem), recordings).events


def beside_events(problem: Problem, terms: Sequence[Term], found: Sequence[Found]) -> Problem:
    """Return a problem with events, whose contribution, given some terms, is subtracted from its measured rows."""
    if not found:
        return problem
    beside = problem.with_events(all_of(found)).with_drift_estimated()
    return beside.without_events(beside.fit(terms))


def unused_events(validation: Prepared | None, fit: Fit, recordings: Sequence[Recording]) -> list[DatedEvent]:
    """Return the events in recordings on which nothing was fitted, given a fit to others; their rows are unchanged.

    There are none without such recordings, and where much stays unexplained next to them.
    """
    if validation is None:
        return []
    own = validation.problem.fit(fit.terms)
    found = find(validation.problem, own, recordings)
    beside = validation.problem.with_events(all_of(found))
    if found and lack_of_fit(beside, beside.fit(fit.terms)) > EVENT_LACK:
        return []
    return with_sizes(beside, own, found, [str(recording.path) for recording in recordings])


def as_events(dated: Sequence[DatedEvent], names: Sequence[str]) -> list[Event]:
    """Return the events in the recordings `names` with the numbers of these recordings."""
    return [
        Event(names.index(d.recording), d.channel, d.kind, d.time, math.inf if d.end is None else d.end)
        for d in dated
        if d.recording in names
    ]


def _simplest(candidates: Sequence[Candidate]) -> Candidate:
    """Return the best candidate, or one of a simpler quantity that is nearly as good."""
    serving = [c for c in candidates if c.score > candidates[0].score - EVENT_SIMPLER]
    order = {quantities: k for k, quantities in enumerate(TOGETHER)}
    return min(serving, key=lambda c: (order.get(c.quantities, len(order)), -c.score))


def _dated(evidence: Evidence, candidate: Candidate, recording: Recording) -> Found:
    """Return an event with the best times of its edges by windows and samples."""
    bench, first = evidence.problem.bench, candidate.first
    windows = evidence.problem.balances[first.recording].windows
    edges, errors = list(first.edges), [0.0] * len(first.edges)

    def moved() -> tuple[Event, ...]:
        return tuple(event.at(*edges) for event in candidate.events)

    if first.kind == "swing":
        return _swinging(evidence, candidate)
    if first.kind not in HAPPENS:
        return Found(candidate.events, tuple(0.0 for _ in edges), candidate.gain)
    if first.kind == "trend":
        return _grown(evidence, candidate, [_between_windows(windows, *span) for span in candidate.spans])
    # the edges of a burst depend on each other
    for k in (0,) if first.kind == "step" else (0, 1, 0, 1):
        edges[k], errors[k] = _by_windows(
            evidence, moved(), k, *_between_windows(windows, *candidate.spans[k])
        )
    by_windows = Found(moved(), tuple(errors), _gain(evidence, [moved()]))
    data, _, _ = readable(samples_of(recording, incomplete=True), bench)
    for k in (0,) if first.kind == "step" else (0, 1, 0, 1):
        wide = min(EVENT_SEARCH * by_windows.errors[k], EVENT_SEARCH_MOST)
        low, high = _between_windows(windows, edges[k] - wide, edges[k] + wide)
        other = edges[1 - k] if first.kind == "burst" else None
        seen = onset(data, bench, candidate.quantities, low, high, other)
        if seen is not None:
            edges[k], errors[k] = seen
    if len(edges) > 1 and edges[1] <= edges[0]:
        return by_windows
    by_samples = Found(moved(), tuple(errors), _gain(evidence, [moved()]))
    # where a reading of the tilt jumps within a window, its fit of a smooth motion is worse than the samples
    less = 0.5 * by_windows.gain if first.quantity in MOTION else EVENT_SIMPLER
    return by_samples if by_samples.gain > by_windows.gain - less else by_windows


def _grown(evidence: Evidence, candidate: Candidate, spans: Sequence[tuple[float, float]]) -> Found:
    """Return a trend with its ends within some times; both are equally uncertain, and depend on each other."""
    ends = [np.linspace(low, high, max(min(_ENDS, round((high - low) / _FINE)), 2)) for low, high in spans]
    pairs = [(a, b) for a in ends[0].tolist() for b in ends[1].tolist() if b > a + TREND_SHORTEST_REFINED]
    if not pairs:
        return Found(candidate.events, tuple(b - a for a, b in spans), candidate.gain)
    gains = _gains(evidence, [[event.at(*pair) for event in candidate.events] for pair in pairs])
    mean, variance = _expected(np.array(pairs), gains)
    errors = np.sqrt(variance + _FINE**2)
    events = tuple(event.at(*mean.tolist()) for event in candidate.events)
    return Found(events, tuple(errors.tolist()), float(gains.max()))


def _swinging(evidence: Evidence, candidate: Candidate) -> Found:
    """Return a swing with its best phase and period by the windows."""
    peak, period = candidate.first.edges
    errors = (0.0, 0.0)
    for part in (0.15, 0.03):
        middle = peak
        periods = period * (1.0 + part * np.linspace(-1.0, 1.0, 11))
        peaks = middle + period * 2.0 * part * np.linspace(-1.0, 1.0, 11)
        pairs = [(a, b) for a in peaks.tolist() for b in periods.tolist()]
        gains = _gains(evidence, [[event.at(*pair) for event in candidate.events] for pair in pairs])
        mean, variance = _expected(np.array(pairs), gains)
        (peak, period), errors = mean.tolist(), tuple(np.sqrt(variance).tolist())
    events = tuple(event.at(peak, period) for event in candidate.events)
    return Found(events, errors, _gain(evidence, [events]))


def _between_windows(windows: Windows, low: float, high: float) -> tuple[float, float]:
    """Return the start of the window before a time, and the end of the one after another time [s]."""
    start, stop = windows.start, windows.start + windows.duration
    first, last = (int(np.searchsorted(start, time)) for time in (low, high))
    return float(start[max(first - 1, 0)]), float(stop[min(last, len(stop) - 1)])


def _gain(evidence: Evidence, changes: Sequence[Sequence[Event]]) -> float:
    """Return the largest gain of changes of the same quantities, of one kind in one recording."""
    return float(_gains(evidence, changes).max())


def _gains(evidence: Evidence, changes: Sequence[Sequence[Event]]) -> Array:
    first = changes[0][0]
    w = evidence.problem.balances[first.recording].windows
    weights = np.array([events[0].course(w) for events in changes])
    profiles = Profiles(first.kind, [events[0].edges for events in changes], weights)
    names = [event.quantity for event in changes[0]]
    lag = first.time if first.kind == "after_tilt" else None
    return evidence.gains(names, first.recording, [profiles], lag)[0]


def _by_windows(
    evidence: Evidence, events: Sequence[Event], k: int, begin: float, end: float
) -> tuple[float, float]:
    """Return the expected time of edge `k` between two times, and its standard error [s]."""
    first = events[0]
    # between windows with a pause between them, all times are about as likely
    span = np.arange(begin, end, max(_FINE, (end - begin) / _TIMES))
    edges = [tuple(t if i == k else own for i, own in enumerate(first.edges)) for t in span.tolist()]
    edges = [own for own in edges if len(own) == 1 or own[1] > own[0] + _FINE]
    gains = _gains(evidence, [[event.at(*own) for event in events] for own in edges])
    mean, variance = _expected(np.array([own[k] for own in edges]), gains)
    return float(mean), math.sqrt(float(variance) + _FINE**2)


def _expected(points: Array, gains: Array) -> tuple[Array, Array]:
    """Return the mean and the variance of points that have these gains in twice the log likelihood."""
    likely = np.exp(0.5 * (gains - gains.max()))
    mean = likely @ points / likely.sum()
    return mean, likely @ (points - mean) ** 2 / likely.sum()


def _same(left: Sequence[Found], right: Sequence[Found]) -> bool:
    """Whether two searches found the same events."""
    if len(left) != len(right):
        return False
    a, b = (sorted((f.event for f in found), key=lambda e: (e.recording, e.time)) for found in (left, right))
    return all(
        (x.recording, x.quantity, x.kind) == (y.recording, y.quantity, y.kind)
        and abs(x.time - y.time) < EVENT_SAME
        for x, y in zip(a, b, strict=True)
    )


def with_sizes(problem: Problem, fit: Fit, found: Sequence[Found], names: Sequence[str]) -> list[DatedEvent]:
    """Return the events at a time, with their sizes given a fit."""
    return [
        DatedEvent(
            recording=names[event.recording],
            time=event.time,
            time_error=own.errors[0],
            end=None if event.kind == "step" else event.end,
            end_error=None if event.kind == "step" else own.errors[1],
            kind=event.kind,
            channel=event.quantity,
            size=size,
            standard_error=error,
            unit=QUANTITIES[event.quantity].unit,
            gain=own.gain,
            ties=(*_READINGS.get(event.quantity, ()), *own.ties),
        )
        for own, event, size, error in _sizes(problem, fit, found)
        if event.kind in HAPPENS
    ]


#: Changes that a turning of the rig makes: the torque of gravity on a centre of gravity off the pivot, along the spin
#: axis, in proportion to the tilt, and with it that of one off to a side.
_OF_ATTITUDE = "torque_along_tilt"
_WITH_ATTITUDE = ("torque_x", "torque_y")
ATTITUDE = "attitude"


def by_attitude(
    events: Sequence[DatedEvent], recordings: Sequence[Recording]
) -> tuple[list[DatedEvent], list[DatedEvent]]:
    """Return the events, and those of them that a turning of the rig explains as well.

    It may where a recording does not state how the rig stood. Constant torques that change at the same time go with it;
    one that changes alone is an event with the tie.
    """
    unstated = {str(recording.path) for recording in recordings if not recording.environment}
    turns = {
        (event.recording, event.time)
        for event in events
        if event.channel == _OF_ATTITUDE and event.recording in unstated
    }
    kept, turned = [], []
    for event in events:
        if event.recording not in unstated or event.channel not in (_OF_ATTITUDE, *_WITH_ATTITUDE):
            kept.append(event)
        elif (event.recording, event.time) in turns:
            turned.append(event)
        else:
            kept.append(replace(event, ties=(*event.ties, ATTITUDE)))
    return kept, turned


def drift_shapes(
    problem: Problem, fit: Fit, found: Sequence[Found], names: Sequence[str]
) -> list[DriftShape]:
    """Return the shapes of drifts, with their sizes given a fit."""
    result = []
    for own, event, size, error in _sizes(problem, fit, found):
        if event.kind in HAPPENS:
            continue
        span = 0.0
        if event.kind in TEMPERATURES:
            span = float(np.ptp(temperature(problem.balances[event.recording].windows, event.kind)))
        time = event.end if event.kind == "swing" else event.time
        result.append(
            DriftShape(
                recording=names[event.recording],
                kind=event.kind,
                channel=event.quantity,
                size=size,
                standard_error=error,
                unit=QUANTITIES[event.quantity].unit,
                time=time,
                time_error=own.errors[1] if event.kind == "swing" else 0.0,
                temperature_change=span,
                gain=own.gain,
            )
        )
    return result


def _sizes(problem: Problem, fit: Fit, found: Sequence[Found]) -> Iterator[tuple[Found, Event, float, float]]:
    """Yield every single event with its size and the standard error."""
    if not found:
        return
    sizes, covariance = problem.event_sizes(fit)
    for own in found:
        for event in own.events:
            k = problem.events.index(event)
            yield own, event, float(sizes[k]), math.sqrt(float(covariance[k, k]))


def parts_between(events: Sequence[DatedEvent]) -> Iterator[str]:
    """Yield the parts of recordings before, between and after their events, as `Recording.open` takes them."""
    for recording in dict.fromkeys(event.recording for event in events):
        place, (begin, until) = parted(recording)
        edges = [begin]
        for event in events:
            if event.recording == recording:
                edges += [event.time, event.time if event.end is None else event.end]
        edges.append(until)
        for first, last in zip(edges[::2], edges[1::2], strict=True):
            limits = [f"from={first:.1f}"] if math.isfinite(first) else []
            limits += [f"until={last:.1f}"] if math.isfinite(last) else []
            if first < last:  # events may overlap
                yield f"{place}@{','.join(limits)}"
