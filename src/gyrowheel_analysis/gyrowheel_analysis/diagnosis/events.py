"""Events in recordings: found, dated, and taken along in the fit, so that no effect is invented to explain them."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gyrowheel_analysis.diagnosis.event_scan import PREFERRED, Candidate, Evidence, Profiles, scan
from gyrowheel_analysis.diagnosis.selection import Progress, Selection, select
from gyrowheel_analysis.diagnosis.unknown import Proposal, search
from gyrowheel_analysis.fitting.events import QUANTITIES, Event, Kind
from gyrowheel_analysis.fitting.fit import Fit
from gyrowheel_analysis.fitting.preparation import samples_of
from gyrowheel_analysis.fitting.problem import Problem
from gyrowheel_analysis.fitting.terms import Term
from gyrowheel_analysis.recording import Recording, parted
from gyrowheel_analysis.reduction import readable
from gyrowheel_analysis.reduction.onset import onset

Array = NDArray[np.float64]

#: Gain in twice the log likelihood that an event must bring beyond what chance brings somewhere.
THRESHOLD = 12.0
_MOST = 6
_ROUNDS = 3  # of selecting effects beside events and looking for events beside effects
_SAME = 1.0  # s; an event that moves by less is the same
_FINE = 0.1  # s between the edges that are tried within windows
_NEAR = 5.0  # s within which another change may be the same event
_TIE = 14.0  # gain within which another quantity explains an event as well
#: Readings whose shift looks like a torque in every window.
_READINGS = {"torque_x": ("coil_voltage_x",), "torque_y": ("coil_voltage_y",)}


@dataclass(frozen=True)
class DatedEvent:
    """Something that changed in the middle of a recording.

    Attributes
    ----------
    recording : str
        In which recording.
    time, time_error : float
        When it began, from the start of that recording, and the standard error [s].
    end, end_error : float or None
        When it ended (a burst) or reached its size (a trend), and the standard error [s]; None for a step.
    kind : str
        ``step``, ``trend`` or ``burst``.
    channel : str
        What changed, one of `fitting.events.QUANTITIES`.
    size, standard_error : float
        By how much, in `unit`.
    unit : str
        Unit of the size.
    gain : float
        By how much it raises twice the log likelihood of the recordings.
    ties : tuple of str
        Other quantities whose change explains the recordings as well.
    """

    recording: str
    time: float
    time_error: float
    end: float | None
    end_error: float | None
    kind: Kind
    channel: str
    size: float
    standard_error: float
    unit: str
    gain: float
    ties: tuple[str, ...] = ()


@dataclass(frozen=True)
class Found:
    """An event that was found, before its size is known.

    Attributes
    ----------
    event : Event
        The event.
    errors : tuple of float
        Standard errors of its edges [s].
    gain : float
        By how much it raises twice the log likelihood.
    ties : tuple of str
        Other quantities that would serve.
    """

    event: Event
    errors: tuple[float, ...]
    gain: float
    ties: tuple[str, ...]


@dataclass(frozen=True)
class Outcome:
    """What recordings show: effects, perhaps a free form, and events.

    Attributes
    ----------
    problem : Problem
        With the events, and with what they do taken from the measured rows.
    selection : Selection
        The effects beside the events.
    proposal : Proposal or None
        The free form beside them, if there is one.
    events : list of Found
        The events, in order of recording and time.
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
        return self.problem.evidence(self.fit) + THRESHOLD * len(self.events)


def explain(
    problem: Problem, selection: Selection, recordings: Sequence[Recording], progress: Progress | None = None
) -> Outcome:
    """Look for events, and for what effects or a free form are beside them.

    Events are accepted if together with what is found beside them they make the recordings likelier than effects and a
    free form do without them.

    Parameters
    ----------
    problem : Problem
        The problem without events.
    selection : Selection
        The effects selected so.
    recordings : sequence of Recording
        Its recordings.
    progress : callable, optional
        Called with a line of text now and then.
    """
    found = find(problem, selection.best, recordings)
    without = Outcome(problem, selection, search(problem, selection, progress=progress), [])
    if not found:
        return without
    if without.proposal is not None:
        with_events = problem.with_events([f.event for f in found])
        gain = problem.evidence(selection.best) - with_events.evidence(selection.best)
        if without.proposal.gain > gain - THRESHOLD * len(found):
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
    if best.evidence > without.evidence:
        return without
    # so that what is shown of the residual is without them
    cleared = best.problem.without_events(best.fit)
    selection = select(cleared)
    return Outcome(
        cleared,
        selection,
        search(cleared, selection),
        sorted(best.events, key=lambda f: (f.event.recording, f.event.time)),
    )


def _beside(problem: Problem, found: list[Found]) -> Outcome:
    """Return effects and free form beside events."""
    beside = problem.with_events([f.event for f in found]).with_drift_estimated()
    selection = select(beside)
    return Outcome(beside, selection, search(beside, selection), found)


def find(problem: Problem, fit: Fit, recordings: Sequence[Recording]) -> list[Found]:
    """Return the events that recordings show about a fit, the strongest first."""
    found: list[Found] = []
    while len(found) < _MOST:
        evidence = Evidence(problem.with_events([f.event for f in found]), fit)
        candidates = scan(evidence)
        best = _simplest(candidates)
        if best.score < THRESHOLD:
            break
        dated = _dated(evidence, best.event, recordings[best.event.recording])
        if best.event.kind == "trend" and (steps := [c for c in candidates if _may_be(c, best.event)]):
            # a step within a window looks like a short trend
            step = _dated(evidence, steps[0].event, recordings[best.event.recording])
            dated = step if step.gain > dated.gain - PREFERRED else dated
        if any(_alike(dated.event, f.event) for f in found):
            break
        found.append(Found(dated.event, dated.errors, dated.gain, _ties(candidates, best.event, best.gain)))
    return found


def _may_be(candidate: Candidate, trend: Event) -> bool:
    """Whether a candidate is a step that may be what a trend shows."""
    e = candidate.event
    return (e.kind, e.recording, e.quantity) == ("step", trend.recording, trend.quantity) and (
        trend.time - _NEAR < e.time < trend.end + _NEAR
    )


def _alike(left: Event, right: Event) -> bool:
    """Whether two events are the same change of the same quantity."""
    same = (left.recording, left.quantity, left.kind) == (right.recording, right.quantity, right.kind)
    return same and all(abs(a - b) < _SAME for a, b in zip(left.edges, right.edges, strict=True))


def _ties(candidates: Sequence[Candidate], event: Event, gain: float) -> tuple[str, ...]:
    """Return other quantities of which a change at the same time brings nearly as much."""
    near = [
        c.event.quantity
        for c in candidates
        if c.gain > gain - _TIE
        and c.event.quantity != event.quantity
        and (c.event.recording, c.event.kind) == (event.recording, event.kind)
        and all(abs(a - b) < _NEAR for a, b in zip(c.event.edges, event.edges, strict=True))
    ]
    return tuple(dict.fromkeys(near))


def accepted(problem: Problem, fit: Fit, recordings: Sequence[Recording]) -> list[Found]:
    """Return the events beside a fit that effects and free forms do not explain better (`explain`)."""
    if not find(problem, fit, recordings):
        return []
    return explain(problem, select(problem), recordings).events


def beside_events(problem: Problem, terms: Sequence[Term], found: Sequence[Found]) -> Problem:
    """Return a problem with events, and with what they do beside some terms taken from its measured rows."""
    if not found:
        return problem
    beside = problem.with_events([f.event for f in found]).with_drift_estimated()
    return beside.without_events(beside.fit(terms))


def unused_events(validation: Problem, fit: Fit, recordings: Sequence[Recording]) -> list[DatedEvent]:
    """Return the events in recordings on which nothing was fitted; their rows are left as they are.

    Parameters
    ----------
    validation : Problem
        The problem of these recordings.
    fit : Fit
        The fit to other recordings.
    recordings : sequence of Recording
        The recordings.
    """
    own = validation.fit(fit.terms)
    found = find(validation, own, recordings)
    beside = validation.with_events([f.event for f in found])
    return with_sizes(beside, own, found, [str(recording.path) for recording in recordings])


def as_events(dated: Sequence[DatedEvent], names: Sequence[str]) -> list[Event]:
    """Return the events in the recordings `names` as a problem of these recordings takes them."""
    return [
        Event(names.index(d.recording), d.channel, d.kind, d.time, math.inf if d.end is None else d.end)
        for d in dated
        if d.recording in names
    ]


def _simplest(candidates: Sequence[Candidate]) -> Candidate:
    """Return the best candidate, or one of a simpler quantity that serves nearly as well."""
    order = list(QUANTITIES)
    serving = [c for c in candidates if c.score > candidates[0].score - PREFERRED]
    return min(serving, key=lambda c: (order.index(c.event.quantity), -c.score))


@dataclass(frozen=True)
class _Dated:
    """An event with its edges as exactly as they are seen, their standard errors [s], and its gain."""

    event: Event
    errors: tuple[float, ...]
    gain: float


def _dated(evidence: Evidence, event: Event, recording: Recording) -> _Dated:
    """Return an event with its edges as exactly as windows and samples show them."""
    bench = evidence.problem.bench
    data, _, _ = readable(samples_of(recording), bench)
    windows = evidence.problem.balances[event.recording].windows
    start, stop = windows.start, windows.start + windows.duration
    edges, errors = list(event.edges), [0.0] * len(event.edges)
    ranges = []
    # the edges of a trend or a burst depend on each other
    for k in (0,) if event.kind == "step" else (0, 1, 0, 1):
        after = int(np.searchsorted(start, edges[k]))
        reach = 4 if event.kind == "trend" else 2 if event.quantity.startswith("tilt_reading") else 1
        begin = float(start[max(after - reach, 0)])
        end = float(stop[min(after + reach - 1, len(stop) - 1)])
        edges[k], errors[k] = _by_windows(evidence, event.at(*edges), k, begin, end)
        ranges.append((k, begin, end))
    by_windows = _Dated(event.at(*edges), tuple(errors), _gain(evidence, event.at(*edges)))
    if event.kind == "trend":
        return by_windows
    for k, begin, end in ranges:
        other = edges[1 - k] if event.kind == "burst" else None
        seen = onset(data, bench, event.quantity, begin, end, other)
        if seen is not None:
            edges[k], errors[k] = seen
    if len(edges) > 1 and edges[1] <= edges[0]:
        return by_windows
    by_samples = _Dated(event.at(*edges), tuple(errors), _gain(evidence, event.at(*edges)))
    return by_samples if by_samples.gain > by_windows.gain - PREFERRED else by_windows


def _gain(evidence: Evidence, *events: Event) -> float:
    """Return the largest gain of events of one quantity and kind in one recording."""
    return float(_gains(evidence, events).max())


def _gains(evidence: Evidence, events: Sequence[Event]) -> Array:
    first = events[0]
    w = evidence.problem.balances[first.recording].windows
    weights = np.array([event.profile(w.start, w.duration) for event in events])
    profiles = Profiles(first.kind, [event.edges for event in events], weights)
    return evidence.gains(first.quantity, first.recording, profiles)


def _by_windows(evidence: Evidence, event: Event, k: int, begin: float, end: float) -> tuple[float, float]:
    """Return the likeliest time of edge `k` between two times, and its standard error [s]."""
    span = np.arange(begin, end, _FINE * (5.0 if event.kind == "trend" else 1.0))
    edges = [tuple(t if i == k else own for i, own in enumerate(event.edges)) for t in span.tolist()]
    edges = [own for own in edges if len(own) == 1 or own[1] > own[0] + _FINE]
    gains = _gains(evidence, [event.at(*own) for own in edges])
    likely = np.exp(0.5 * (gains - gains.max()))
    times = np.array([own[k] for own in edges])
    mean = float(likely @ times / likely.sum())
    return float(times[np.argmax(gains)]), math.sqrt(
        float(likely @ (times - mean) ** 2 / likely.sum()) + _FINE**2
    )


def _same(left: Sequence[Found], right: Sequence[Found]) -> bool:
    """Whether two searches found the same events."""
    if len(left) != len(right):
        return False
    a, b = (sorted((f.event for f in found), key=lambda e: (e.recording, e.time)) for found in (left, right))
    return all(
        (x.recording, x.quantity, x.kind) == (y.recording, y.quantity, y.kind)
        and abs(x.time - y.time) < _SAME
        for x, y in zip(a, b, strict=True)
    )


def with_sizes(problem: Problem, fit: Fit, found: Sequence[Found], names: Sequence[str]) -> list[DatedEvent]:
    """Return events with their sizes beside a fit."""
    if not found:
        return []
    sizes, covariance = problem.event_sizes(fit)
    order = [problem.events.index(f.event) for f in found]
    return [
        DatedEvent(
            recording=names[f.event.recording],
            time=f.event.time,
            time_error=f.errors[0],
            end=None if f.event.kind == "step" else f.event.end,
            end_error=None if f.event.kind == "step" else f.errors[1],
            kind=f.event.kind,
            channel=f.event.quantity,
            size=float(sizes[k]),
            standard_error=math.sqrt(float(covariance[k, k])),
            unit=QUANTITIES[f.event.quantity].unit,
            gain=f.gain,
            ties=(*_READINGS.get(f.event.quantity, ()), *f.ties),
        )
        for f, k in zip(found, order, strict=True)
    ]


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
