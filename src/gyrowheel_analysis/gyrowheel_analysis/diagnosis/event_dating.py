"""Events with the best times of their edges: by the windows, and by the samples where these show an instant."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gyrowheel_analysis.criteria import (
    EVENT_SEARCH,
    EVENT_SEARCH_MOST,
    EVENT_SIMPLER,
    TREND_SHORTEST_REFINED,
)
from gyrowheel_analysis.diagnosis.event_scan import PHASES, Candidate
from gyrowheel_analysis.diagnosis.evidence import Evidence, Profiles
from gyrowheel_analysis.fitting.events import HAPPENS, MOTION, Event
from gyrowheel_analysis.fitting.preparation import samples_of
from gyrowheel_analysis.reduction.onset import onset
from gyrowheel_analysis.reduction.quality import readable
from gyrowheel_analysis.reduction.windows import Windows
from gyrowheel_recording.bags import Recording

Array = NDArray[np.float64]

_FINE = 0.1  # s between tried edges within windows
_TIMES = 10_000  # tried times of an edge, at most
_ENDS = 25  # tried times of each end of a trend


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


def with_times(evidence: Evidence, candidate: Candidate, recording: Recording) -> Found:
    """Return an event with the best times of its edges by windows and samples."""
    bench, first = evidence.problem.bench, candidate.first
    windows = evidence.problem.balances[first.recording].windows
    edges, errors = list(first.edges), [0.0] * len(first.edges)

    def moved() -> tuple[Event, ...]:
        return tuple(event.at(*edges) for event in candidate.events)

    if first.kind == "swing":
        return _swinging(evidence, candidate.events)
    if first.kind not in HAPPENS:
        return Found(candidate.events, tuple(0.0 for _ in edges), candidate.gain)
    if first.kind == "trend":
        return _grown(evidence, candidate, [_between_windows(windows, *span) for span in candidate.spans])
    # the edges of a burst depend on each other
    for k in (0,) if first.kind == "step" else (0, 1, 0, 1):
        edges[k], errors[k] = _by_windows(
            evidence, moved(), k, *_between_windows(windows, *candidate.spans[k])
        )
    by_windows = Found(moved(), tuple(errors), gain_of(evidence, [moved()]))
    data, _, _ = readable(samples_of(recording, incomplete=True), bench)
    for k in (0,) if first.kind == "step" else (0, 1, 0, 1):
        wide = min(EVENT_SEARCH * by_windows.errors[k], EVENT_SEARCH_MOST)
        low, high = _between_windows(windows, edges[k] - wide, edges[k] + wide)
        other = edges[1 - k] if first.kind == "burst" else None
        seen = onset(data, bench, candidate.quantities, low, high, other)
        if seen is not None:
            edges[k], errors[k] = seen
    if len(edges) > 1 and edges[1] <= edges[0]:
        return _determined(by_windows, candidate, windows)
    by_samples = Found(moved(), tuple(errors), gain_of(evidence, [moved()]))
    # where a reading of the tilt jumps within a window, its fit of a smooth motion is worse than the samples
    less = 0.5 * by_windows.gain if first.quantity in MOTION else EVENT_SIMPLER
    best = by_samples if by_samples.gain > by_windows.gain - less else by_windows
    return _determined(best, candidate, windows)


def _determined(found: Found, candidate: Candidate, windows: Windows) -> Found:
    """Return an event, a burst of a reading of the tilt with a whole window in it.

    Windows in which such a reading jumps get no weight, so that its size would be anything without another one.
    """
    first = found.event
    if first.kind != "burst" or first.quantity not in MOTION:
        return found
    if np.any((windows.start >= first.time) & (windows.start + windows.duration <= first.end)):
        return found
    errors = tuple((high - low) / math.sqrt(12.0) for low, high in candidate.spans)
    return Found(candidate.events, errors, candidate.gain)


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


def swing_in(evidence: Evidence, events: Sequence[Event], recording: int) -> Found:
    """Return swings of the same quantities and about the same period in another recording, with their best phase."""
    there = [replace(event, recording=recording) for event in events]
    period = there[0].end
    begin = float(evidence.problem.balances[recording].windows.start.min())
    peaks = begin + period * np.arange(PHASES) / (2.0 * PHASES)
    gains = _gains(evidence, [[event.at(peak, period) for event in there] for peak in peaks.tolist()])
    return _swinging(evidence, [event.at(float(peaks[np.argmax(gains)]), period) for event in there])


def _swinging(evidence: Evidence, events: Sequence[Event]) -> Found:
    """Return a swing with its best phase and period by the windows."""
    peak, period = events[0].edges
    windows = evidence.problem.balances[events[0].recording].windows
    errors = (0.0, 0.0)
    for part in (0.15, 0.03):
        periods = periods_about(period, windows, part)
        peaks = peak + period * 2.0 * part * np.linspace(-1.0, 1.0, 11)
        pairs = [(a, b) for a in peaks.tolist() for b in periods.tolist()]
        gains = _gains(evidence, [[event.at(*pair) for event in events] for pair in pairs])
        mean, variance = _expected(np.array(pairs), gains)
        (peak, period), errors = mean.tolist(), tuple(np.sqrt(variance).tolist())
    found = tuple(event.at(peak, period) for event in events)
    return Found(found, errors, gain_of(evidence, [found]))


def periods_about(period: float, windows: Windows, part: float = 0.15) -> Array:
    """Return periods that differ by at most `part`: many turns add up to the same phase only if the period is right."""
    turns = float((windows.start + windows.duration).max() - windows.start.min()) / period
    return np.asarray(period * (1.0 + part * min(1.0, 1.5 / turns) * np.linspace(-1.0, 1.0, 11)))


def _between_windows(windows: Windows, low: float, high: float) -> tuple[float, float]:
    """Return the start of the window before a time, and the end of the one after another time [s]."""
    start, stop = windows.start, windows.start + windows.duration
    first, last = (int(np.searchsorted(start, time)) for time in (low, high))
    return float(start[max(first - 1, 0)]), float(stop[min(last, len(stop) - 1)])


def gain_of(evidence: Evidence, changes: Sequence[Sequence[Event]]) -> float:
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
